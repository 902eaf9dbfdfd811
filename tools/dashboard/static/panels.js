// Tools, health, reports: what changes once a second.
import { setTools } from "./calibrate.js";
import { el, keep, make, setText } from "./dom.js";

const LAMPS = { ready: "good", starting: "advice", degraded: "warn", stopped: "warn", fault: "bad", silent: "bad" };
const NAMES = { ft: "Sensor", motors: "Motors", tracker: "Tracker", compensation: "Compensation", calibration: "Calibration", deflection: "Deflection", admittance: "Hand-over-hand", recorder: "Recorder" };
const GAUGES = [
  ["noise_n", "Noise", (x, g) => `${(1000 * x).toFixed(0)} mN${g.calibration_noise_n ? `, was ${(1000 * g.calibration_noise_n).toFixed(0)}` : ""}`],
  ["rest_force_n", "Off zero at rest", (x) => `${x.toFixed(3)} N`],
  ["drift_n_per_s", "Drift at rest", (x) => (x ? `${(60 * x).toFixed(3)} N/min` : "none seen")],
  ["lost_share", "Samples lost", (x) => `${(100 * x).toFixed(2)} %`],
  ["daemon.core bus_load_share ft", "CAN bus", (x) => `${(100 * x).toFixed(0)} % at most`],
  ["daemon.core disk_free_bytes", "Disk free", (x) => `${(x / 1e9).toFixed(1)} GB`],
  ["daemon.core machine_temperature_c", "Computer", (x) => `${x.toFixed(0)} °C`],
  ["calibration_age_days", "Calibrated", (x) => (x < 1 ? "today" : `${x.toFixed(0)} days ago`)],
];
let inHand = null;

export function showLive(m) {
  inHand = m.tool ?? null;
  el("enable").setAttribute("aria-pressed", String(Boolean(m.enabled)));
  el("enable").hidden = !m.tool && !m.enabled && m.tool !== "";
  el("untare").hidden = !m.tared;
  const joints = m.joints;
  const words = joints ? Object.entries(joints.position).map(([name, x]) => `${name} ${/carriage/.test(name) ? `${(1000 * x).toFixed(0)} mm` : `${((180 / Math.PI) * x).toFixed(1)}°`}`) : [];
  setText(el("joints"), joints ? [joints.estop ? "EMERGENCY STOP" : joints.moving ? "moving" : "at rest", ...words].join("  ·  ") : "joints are silent");
  markTools();
}

function markTools() {
  for (const button of el("tools").querySelectorAll("button")) button.setAttribute("aria-pressed", String((button.dataset.tool || "") === (inHand ?? "?")));
}

export function showAbout(m) {
  setText(el("robot"), m.robot ?? "galen-hw");
  el("virtual").hidden = !m.virtual;
  const motors = m.devices?.motors;
  el("motors").hidden = !motors || !motors.held;
  el("held").hidden = !motors?.held;
  setText(el("held"), motors?.held ? `The motors are held: ${motors.held.split(";")[0]}` : "");
}

export function showLists(m, press, may) {
  const tools = [{ name: "", label: "No tool" }, ...m.tools];
  keep(el("tools"), [tools, may], () => tools.map((tool) => toolButton(tool, press, may)));
  markTools();
  setTools(m.tools, press, may);
  keep(el("reports"), m.reports, () =>
    m.reports.length
      ? m.reports.map((report) => {
          const link = make("a", { href: `/reports/${report.link}`, target: "_blank", rel: "noopener", text: report.name });
          return make("li", {}, link, make("small", { text: new Date(1000 * report.at).toLocaleString() }));
        })
      : [make("li", { cls: "note", text: "none yet: a calibration makes one" })],
  );
}

function toolButton(tool, press, may) {
  const usable = tool.name === "" || tool.calibrated;
  const more = tool.problem ?? (tool.name === "" ? "its weight stays in the wrench" : tool.calibrated ? `${tool.mass_g.toFixed(0)} g, ${tool.date.slice(0, 10).replaceAll("-", "\u2011")}` : "never calibrated");
  const button = make("button", { text: tool.label ?? tool.name, disabled: !may || !usable }, make("small", { text: more }));
  button.dataset.tool = tool.name;
  button.dataset.needsToken = "1";
  button.dataset.off = usable ? "0" : "1";
  button.onclick = () => press(button, { do: "select", tool: tool.name || null });
  return button;
}

export function showHealth(m) {
  const silent = m.age_s > 3.5;
  const words = { good: "all is well", advice: "advice", warning: "warning", fault: "fault" };
  setText(el("health-note"), silent ? `silent for ${m.age_s.toFixed(0)} s` : words[m.state] ?? m.state);
  const alarms = silent ? [{ level: "fault", what: `Health says nothing for ${m.age_s.toFixed(0)} s`, todo: "see galen-hw monitor" }] : m.alarms;
  keep(el("alarms"), alarms, () =>
    alarms.length ? alarms.map((a) => make("li", { cls: a.level, text: a.what }, make("small", { text: a.todo }))) : [make("li", { cls: "none", text: "No alarm" })],
  );
  const parts = Object.entries(m.parts).filter(([name]) => !name.startsWith("daemon.") && name !== "health");
  const daemons = Object.entries(m.parts).filter(([name]) => name.startsWith("daemon."));
  const worst = daemons.find(([, s]) => LAMPS[s] === "bad") ?? daemons.find(([, s]) => LAMPS[s] !== "good");
  if (daemons.length) parts.push(["Processes", worst ? worst[1] : "ready"]);
  keep(el("lights"), [parts, m.details, silent], () => parts.map(([name, s]) => light(name, silent ? "silent" : s, m.details[name])));
  const shown = GAUGES.filter(([key]) => Number.isFinite(m.gauges[key]));
  keep(el("gauges"), shown.map(([key, , text]) => text(m.gauges[key], m.gauges)), () =>
    shown.map(([key, name, text]) => make("div", {}, make("dt", { text: name }), make("dd", { text: text(m.gauges[key], m.gauges) }))),
  );
}

function light(name, s, detail) {
  const row = make("li", { title: detail ?? "" }, make("span", { cls: `lamp ${LAMPS[s] ?? "warn"}` }));
  row.append(make("div", { text: NAMES[name] ?? name }, make("small", { text: s })));
  return row;
}

export function showFaults(m) {
  const faults = [...m.faults].reverse().slice(0, 6);
  keep(el("faults"), faults, () =>
    faults.length
      ? faults.map((f) => make("li", { text: f.what }, make("small", { text: `${f.where}${f.todo ? `: ${f.todo}` : ""} · ${new Date(1000 * f.at).toLocaleTimeString()}` })))
      : [make("li", { cls: "note", text: "nothing since this page's server began to listen" })],
  );
}
