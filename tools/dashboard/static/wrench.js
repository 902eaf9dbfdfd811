// Numbers, bars and traces of the wrench: bold what is compensated, thin what the sensor reads; red where it is not valid.
import { colour, el, make, setText } from "./dom.js";

const SPAN_S = 20;
const AXES = ["x", "y", "z"];
const FULL = { force: 10, torque: 1 };
const rows = []; // [time s, raw 6, compensated 6, share valid]
const plots = [];
let bars = null;

export function addRows(more, now) {
  rows.push(...more);
  const old = rows.findIndex((row) => row[0] > now - SPAN_S - 2);
  if (old > 0) rows.splice(0, old);
}

function buildBars() {
  bars = [];
  for (const [kind, name] of [["force", "F"], ["torque", "T"]]) {
    for (const axis of AXES) {
      const fill = make("i");
      const number = make("td", { text: "–" });
      const bar = make("span", { cls: `bar ${axis}` }, fill);
      const label = make("td", { cls: axis, text: `${name}${axis}` });
      el("axes").append(make("tr", {}, label, number, make("td", {}, bar)));
      bars.push({ kind, number, fill });
    }
  }
}

function setBar(bar, value) {
  const share = Math.max(-1, Math.min(1, value / FULL[bar.kind])) * 50;
  bar.fill.style.left = `${share < 0 ? 50 + share : 50}%`;
  bar.fill.style.width = `${Math.abs(share)}%`;
}

const minus = (number) => String(number).replace("-", "−");

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) ? `−${text}` : text;
}

export function showWrench(live) {
  if (!bars) buildBars();
  const last = live && rows.length && live.now - rows[rows.length - 1][0] < 0.6 ? rows[rows.length - 1] : null;
  // Of a tenth of a second: a number that dances cannot be read.
  const recent = last ? rows.slice(-5) : [];
  const mean = (i) => recent.reduce((sum, row) => sum + (row[i] ?? NaN), 0) / recent.length;
  const six = last ? [7, 8, 9, 10, 11, 12].map(mean) : null;
  const known = six && six.every(Number.isFinite);
  setText(el("force"), known ? Math.hypot(...six.slice(0, 3)).toFixed(2) : "–");
  setText(el("torque"), known ? (1000 * Math.hypot(...six.slice(3))).toFixed(0) : "–");
  bars.forEach((bar, i) => {
    const milli = bar.kind === "torque";
    setText(bar.number, known ? signed(milli ? 1000 * six[i] : six[i], milli ? 0 : 2) : "–");
    setBar(bar, known ? six[i] : 0);
  });
  const by = !live ? "" : live.enabled && live.calibration ? `with ${live.calibration}` : "no tool's weight is taken off";
  setText(el("made-by"), live ? by + (live.tared ? ", tared" : "") : "");
}

function paintInvalid(u) {
  const { ctx } = u;
  ctx.save();
  ctx.fillStyle = colour("bad-bg");
  let from = null;
  const valid = u.data[u.data.length - 1];
  for (let i = 0; i <= valid.length; i++) {
    const bad = i < valid.length && valid[i] < 1;
    if (bad && from === null) from = i;
    if (!bad && from !== null) {
      const a = u.valToPos(u.data[0][from], "x", true);
      const b = u.valToPos(u.data[0][Math.min(i, valid.length - 1)], "x", true);
      ctx.fillRect(a, u.bbox.top, Math.max(1, b - a), u.bbox.height);
      from = null;
    }
  }
  ctx.restore();
}

function makePlot(id, least) {
  const place = el(id);
  const series = [{}];
  for (const raw of [true, false]) {
    for (const axis of AXES) {
      series.push({ stroke: () => colour(axis) + (raw ? "88" : ""), width: raw ? 1 : 2.2, dash: raw ? [2, 3] : undefined, points: { show: false } });
    }
  }
  series.push({ show: false });
  const axis = { stroke: () => colour("soft"), grid: { stroke: () => colour("line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  const range = (u, low, high) => {
    const most = Math.max(least, Math.abs(low ?? 0), Math.abs(high ?? 0));
    return [-1.1 * most, 1.1 * most];
  };
  const options = {
    width: place.clientWidth || 300,
    height: place.clientHeight || 180,
    legend: { show: false },
    cursor: { show: false },
    series,
    scales: { x: { time: false, range: () => [-SPAN_S, 0] }, y: { range } },
    axes: [{ ...axis, size: 24, values: (u, at) => at.map((t) => `${minus(t)} s`) }, { ...axis, size: 46, values: (u, at) => at.map(minus) }],
    hooks: { drawClear: [paintInvalid] },
  };
  const plot = new uPlot(options, [[], [], [], [], [], [], [], []], place);
  new ResizeObserver(() => plot.setSize({ width: place.clientWidth, height: place.clientHeight })).observe(place);
  return plot;
}

export function redrawPlots(now, silentS) {
  if (!plots.length) {
    plots.push({ plot: makePlot("plot-force", 1), first: 1, factor: 1 }, { plot: makePlot("plot-torque", 50), first: 4, factor: 1000 });
    el("key").append(
      ...AXES.map((axis) => make("b", { cls: axis, text: axis })),
      make("i", { text: "thick: compensated, thin: as the sensor reads" }),
    );
  }
  const time = rows.map((row) => row[0] - now - silentS);
  for (const { plot, first, factor } of plots) {
    const column = (i) => rows.map((row) => (row[i] === null ? null : factor * row[i]));
    const data = [time];
    for (const base of [first, first + 6]) for (let i = 0; i < 3; i++) data.push(column(base + i));
    data.push(rows.map((row) => row[13]));
    plot.setData(data);
  }
}
redrawPlots.restyle = () => plots.forEach(({ plot }) => plot.redraw(false, true));
