// Small helpers; text only ever becomes text, never HTML.
export const el = (id) => document.getElementById(id);

export function make(tag, { text, cls, ...more } = {}, ...children) {
  const node = document.createElement(tag);
  if (text !== undefined) node.textContent = text;
  if (cls) node.className = cls;
  Object.assign(node, more);
  node.append(...children);
  return node;
}

// Build anew only when what is to be shown has changed: a button must not vanish under a finger.
const shown = new WeakMap();
export function keep(node, key, build) {
  const text = JSON.stringify(key);
  if (shown.get(node) === text) return;
  shown.set(node, text);
  node.replaceChildren(...build());
}

export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

let timer = 0;
export function toast(text, ok) {
  const box = el("toast");
  box.textContent = text;
  box.className = ok ? "toast" : "toast bad";
  box.hidden = false;
  clearTimeout(timer);
  timer = setTimeout(() => (box.hidden = true), ok ? 2500 : 7000);
}

export function ask(text, yes) {
  const box = el("ask");
  el("ask-text").textContent = text;
  el("ask-yes").textContent = yes;
  return new Promise((done) => {
    el("ask-yes").onclick = () => box.close("yes");
    el("ask-no").onclick = () => box.close("no");
    box.onclose = () => done(box.returnValue === "yes");
    box.returnValue = "no";
    box.showModal();
  });
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
