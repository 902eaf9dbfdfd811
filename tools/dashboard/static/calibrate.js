// A calibration step by step: what the operator must do now, in one sentence, with one large button.
import { ask, el, keep, make, setText } from "./dom.js";

let step = "idle";
let tools = [];
let chosen = "";
let progress = null;

const clock = (s) => `${Math.floor(s / 60)}:${String(Math.round(s % 60)).padStart(2, "0")}`;

function button(text, cls, onclick, may) {
  const made = make("button", { text, cls, onclick });
  made.dataset.needsToken = "1";
  made.disabled = !may;
  return made;
}

export function setTools(found, press, may) {
  tools = found.filter((tool) => !tool.problem).map((tool) => tool.name);
  if (!tools.includes(chosen)) chosen = tools[0] ?? "";
  if (step === "idle") showCalibration({ step: "idle" }, press, may);
}

export function showProgress(found) {
  progress = found ?? null;
  const bar = el("cal-bar");
  if (!bar) return;
  const share = progress && progress.poses ? Math.max(0, progress.pose - (progress.state === "done" ? 0 : 1)) / progress.poses : 0;
  bar.style.width = `${100 * share}%`;
  setText(el("cal-say"), progress ? `${progress.state}, pose ${progress.pose} of ${progress.poses}, ${clock(progress.remaining_s)} left` : "…");
}

export function showCalibration(m, press, may) {
  step = m.step;
  const body = el("cal-body");
  const name = m.tool ?? "";
  setText(el("cal-step"), step === "idle" ? "" : name);
  const key = [m, may, step === "idle" ? [tools, chosen] : []];
  keep(body, key, () => (STEPS[step] ?? STEPS.idle)(m, press, may));
}

const say = (...parts) => make("p", { cls: "say" }, ...parts);
const go = (press, may, text, frame) => button(text, "go", (event) => press(event.currentTarget, frame), may);
const abort = (press, may) => button("Abort", "warn", (event) => press(event.currentTarget, { do: "abort" }), may);
const row = (...buttons) => make("div", { cls: "row" }, ...buttons);

function waiting(press, may, text, virtual, done) {
  const more = virtual ? " (On the virtual robot a virtual hand does it.)" : "";
  return [say(make("b", { text }), more), row(go(press, may, done, { do: "go_on" }), abort(press, may))];
}

function moving(press, may, text) {
  const bar = make("div", { cls: "progress" }, make("i", { id: "cal-bar" }));
  return [say(make("b", { text })), bar, make("p", { cls: "note", id: "cal-say", text: "…" }), row(abort(press, may))];
}

function tile(name, value, more) {
  return make("div", {}, make("dt", { text: name }), make("dd", { text: value }, make("small", { text: more })));
}

const STEPS = {
  idle: (m, press, may) => {
    const choice = make("div", { cls: "choices" });
    for (const tool of tools) {
      const one = make("button", { text: tool, onclick: () => ((chosen = tool), showCalibration({ step: "idle" }, press, may)) });
      one.setAttribute("aria-pressed", String(tool === chosen));
      choice.append(one);
    }
    const begin = button("Calibrate", "go", (event) => start(event.currentTarget, press), may && chosen);
    begin.id = "calibrate";
    return [say("Finds the tool's weight, centre of mass and the sensor's bias. The arm will move."), choice, row(begin)];
  },
  starting: () => [say("Starting …")],
  bare: (m, press, may) => waiting(press, may, "Take any tool off the sensor. Keep hands and cables clear: the arm will move.", m.virtual, "It is off, go on"),
  tool: (m, press, may) => waiting(press, may, `Put the ${m.tool} on, then keep clear.`, m.virtual, "It is on, go on"),
  sweep: (m, press, may) => moving(press, may, "Measuring. Do not touch the arm or the tool."),
  check: (m, press, may) => moving(press, may, "In use. Checking it in slow motion: do not touch."),
  fit: () => [say(make("b", { text: "Computing …" }))],
  decide: (m, press, may) => [
    say(make("b", { text: `Use this for the ${m.tool} from now on?` })),
    ...resultOf(m.result),
    row(go(press, may, "Accept", { do: "decide", accept: true }), button("Reject", "", (event) => press(event.currentTarget, { do: "decide", accept: false }), may)),
  ],
  done: (m, press, may) => [
    say(make("b", { text: m.what })),
    ...(m.accepted && m.result ? resultOf(m.result) : []),
    ...(m.report ? [make("a", { href: `/reports/${m.report}`, target: "_blank", rel: "noopener", text: "Open the report" })] : []),
    row(again(press, may)),
  ],
  failed: (m, press, may) => [say(make("b", { text: "It did not come to its end. " }), m.what), row(again(press, may))],
};

function again(press, may) {
  return button("Calibrate a tool", "", () => showCalibration({ step: "idle" }, press, may), may);
}

function resultOf(r) {
  const [a, b] = [r.com_mm, r.com_half_mm];
  const tiles = make(
    "dl",
    { cls: "result" },
    tile("Mass", `${r.mass_g.toFixed(1)} g`, `± ${r.mass_half_g.toFixed(2)} g`),
    tile("Centre of mass", a.map((x) => x.toFixed(1).replace("-", "−")).join(", "), `mm, ± ${Math.max(...b).toFixed(2)} mm`),
    tile("Residual", `${r.residual_n.toFixed(3)} N`, `${r.residual_nmm.toFixed(2)} N mm`),
  );
  const remarks = r.remarks.length ? [make("ul", { cls: "remarks" }, ...r.remarks.map((text) => make("li", { text })))] : [];
  return [tiles, ...remarks];
}

async function start(pressed, press) {
  if (await ask(`Calibrate the ${chosen}? The arm will move. Are hands and cables clear?`, "Begin")) press(pressed, { do: "calibrate", tool: chosen });
}
