// The page: one websocket, and who is told what comes in on it. Nothing is shown as the present that is not.
import { showArm, setView } from "./arm.js";
import { showCalibration, showProgress } from "./calibrate.js";
import { el, ask, toast } from "./dom.js";
import { showAbout, showFaults, showHealth, showLists, showLive } from "./panels.js";
import { addRows, redrawPlots, showWrench } from "./wrench.js";

const DEAD_MS = 1500;
const ALIVE_MS = 500;
const state = { socket: null, may: false, token: "", n: 0, heard: 0, waiting: new Map(), retry: 250, live: null };

function takeToken() {
  // It comes after the #, which a browser sends to nobody; kept for this tab only, and out of sight.
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found) {
    sessionStorage.setItem("token", found);
    history.replaceState(null, "", location.pathname);
  }
  state.token = sessionStorage.getItem("token") || "";
}

export function send(frame) {
  if (!state.socket || state.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ ok: false, text: "not connected" });
  const n = ++state.n;
  state.socket.send(JSON.stringify({ ...frame, n }));
  return new Promise((done) => state.waiting.set(n, done));
}

async function press(button, frame) {
  button.classList.add("busy");
  const answer = await send(frame);
  button.classList.remove("busy");
  if (answer.text) toast(answer.text, answer.ok);
  return answer;
}

function connect() {
  const socket = new WebSocket(`ws://${location.host}/live`);
  state.socket = socket;
  socket.onopen = () => {
    state.retry = 250;
    if (state.token) send({ do: "hello", token: state.token });
  };
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => {
    state.may = false;
    for (const done of state.waiting.values()) done({ ok: false, text: "the dashboard is gone" });
    state.waiting.clear();
    setRights();
    setTimeout(connect, state.retry);
    state.retry = Math.min(2000, 2 * state.retry);
  };
}

const TAKERS = {
  welcome: () => setRights(),
  hello: (m) => {
    state.may = m.ok;
    if (!m.ok) {
      sessionStorage.removeItem("token");
      state.token = "";
      toast(m.text, false);
    }
    setRights();
    answered(m);
  },
  answer: answered,
  live: (m) => {
    state.heard = performance.now();
    state.live = m;
    addRows(m.bins, m.now);
    showLive(m, press);
    showProgress(m.progress);
    banner(m);
  },
  calibration: (m) => showCalibration(m, press, state.may),
  about: showAbout,
  lists: (m) => showLists(m, press, state.may),
  health: showHealth,
  faults: showFaults,
};

function take(message) {
  TAKERS[message.type]?.(message);
}

function answered(m) {
  state.waiting.get(m.n)?.(m);
  state.waiting.delete(m.n);
}

function setRights() {
  document.body.classList.toggle("may", state.may);
  el("look").hidden = state.may;
  for (const id of ["stop", "enable", "tare", "untare", "zero", "motors"]) el(id).disabled = !state.may;
  for (const button of document.querySelectorAll("[data-needs-token]")) button.disabled = !state.may || button.dataset.off === "1";
}

function banner(m) {
  const bare = !m.enabled || !m.calibration;
  const text = m.why || (bare ? `Valid, but ${m.tool ? "compensation is off" : "no tool is selected"}: a tool's weight is in it` : `Valid: ${m.tool} compensated`);
  const bar = el("banner");
  bar.className = `banner ${m.why ? "bad" : bare ? "warn" : "good"}`;
  if (bar.textContent !== text) bar.textContent = text;
}

function tick() {
  // Drawn by the page's own clock, so that what has ended is seen to have ended.
  const silent = performance.now() - state.heard;
  const dead = !state.heard || silent > DEAD_MS;
  if (dead) {
    const bar = el("banner");
    bar.className = `banner ${state.heard ? "bad" : "wait"}`;
    bar.textContent = state.heard ? `No dashboard for ${(silent / 1000).toFixed(0)} s: nothing below is the present` : "Connecting …";
  }
  const stale = dead || Boolean(state.live?.why);
  document.body.classList.toggle("stale", stale);
  showWrench(dead ? null : state.live);
  redrawPlots(state.live?.now ?? 0, dead ? silent / 1000 : 0);
  showArm(dead ? null : state.live?.arm, stale);
  requestAnimationFrame(() => setTimeout(tick, 100));
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  el("theme").textContent = theme === "dark" ? "Daylight" : "Dark";
  redrawPlots.restyle?.();
}

function begin() {
  takeToken();
  let theme = localStorage.getItem("theme") || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  setTheme(theme);
  el("theme").onclick = () => {
    theme = theme === "dark" ? "light" : "dark";
    localStorage.setItem("theme", theme);
    setTheme(theme);
  };
  el("stop").onclick = (event) => press(event.currentTarget, { do: "stop" });
  el("tare").onclick = (event) => press(event.currentTarget, { do: "tare" });
  el("untare").onclick = (event) => press(event.currentTarget, { do: "untare" });
  el("enable").onclick = (event) => press(event.currentTarget, { do: "enable", on: event.currentTarget.getAttribute("aria-pressed") !== "true" });
  el("motors").onclick = async (event) => {
    const button = event.currentTarget;
    if (await ask("Are hands and cables clear? The motors will be switched on.", "Motors on")) press(button, { do: "motors" });
  };
  el("zero").onclick = async (event) => {
    const button = event.currentTarget;
    if (await ask("Is the tool off, and does nothing touch the sensor?", "Zero now")) press(button, { do: "zero" });
  };
  for (const button of document.querySelectorAll("[data-view]")) button.onclick = () => setView(button.dataset.view);
  setView("side");
  setInterval(() => send({ do: "alive" }).catch(() => {}), ALIVE_MS);
  setRights();
  connect();
  tick();
}

begin();
