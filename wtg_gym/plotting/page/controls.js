// --- controls, and the state in the address ---------------------------------------------------------------------------

const boxes = [...document.querySelectorAll("input[name=kind]")];
const KINDS = boxes.map((box) => box.value);

// Both menus hold what the filters leave, the entry at 100, and what is chosen.
const fillMenus = () => {
  const kept = new Set(shown());
  for (const side of ["a", "b"]) {
    const entries = suite().entries.filter((entry) =>
      kept.has(entry) || entry.name === suite().hundred || entry.name === state[side]);
    $(side).replaceChildren(...entries.map((entry) => option(entry.name, `${entry.rank}. ${entry.name}`)));
    $(side).value = state[side];
  }
};
const fillSuite = () => {
  const { entries, scenarios, seeds, split } = suite();
  const keep = (name, other) => (entryOf(name) ? name : other);
  const best = entries.find((entry) => entry.name !== suite().hundred && suite().traced.includes(entry.name)) ??
    entries.find((entry) => entry.name !== suite().hundred);
  state.a = keep(state.a, best.name);
  state.b = keep(state.b, keep(suite().hundred, entries[1].name));
  $("scenario").replaceChildren(...scenarios.map((each, i) => {
    const what = each.events.map((event) => event.text).join("; ") || "wind alone";
    return option(i, short(`${each.seed}: ${what}`, 90));
  }));
  const [first] = entries;
  const gap = first.gap ? `, which closes ${first.gap[0].toFixed(0)} % of the gap to an oracle with foresight` : "";
  $("about").textContent = `${suite().name}: ${suite().description} Best of ${entries.length} entries: ` +
    `${first.name} with ${first.score[0].toFixed(1)} (${first.score[1].toFixed(1)} … ${first.score[2].toFixed(1)})${gap}. ` +
    `${seeds.length} ${split} scenarios, ${scenarios.length} with traces.`;
  const versions = Object.entries(suite().versions).map(([name, version]) => `${name} ${version}`).join(", ");
  $("made").textContent = `Suite ${suite().hash.slice(0, 12)}, source ${suite().source.slice(0, 12)}; ${versions}.`;
};

// Everything anew from the state.
const refresh = (settings) => {
  fillSuite();
  for (const name of ["suite", "find", "action", "scenario"]) $(name).value = state[name];
  for (const box of boxes) box.checked = state.kinds.includes(box.value);
  $("limits").checked = state.limits;
  fillMenus();
  fillRules();
  fillRanking();
  fillCompare();
  remember();
  return drill(settings);
};
const choose = (place, settings) => {
  state.scenario = place;
  $("scenario").value = place;
  fillCompare();
  remember();
  return drill(settings);
};
const filter = () => {
  Object.assign(state, {
    find: $("find").value, action: $("action").value,
    kinds: boxes.filter((box) => box.checked).map((box) => box.value),
  });
  fillMenus();
  fillRanking();
  remember();
};

// --- the address ---

const address = () => {
  const words = new URLSearchParams({ suite: suite().name, a: state.a, b: state.b });
  if (scenario()) words.set("scenario", scenario().seed);
  if (state.table) words.set("t", state.time.toFixed(1));
  if (state.kinds.length < KINDS.length) words.set("kind", state.kinds.join(","));
  for (const name of ["action", "find"]) if (state[name]) words.set(name, state[name]);
  if (state.sort) words.set("sort", `${state.sort.column},${state.sort.down ? "down" : "up"}`);
  if (state.limits) words.set("limits", "on");
  return `#${words}`;
};
let writing = 0, ready = false;
// Not at once: browsers refuse too many changes.
const remember = () => {
  clearTimeout(writing);
  if (ready) writing = setTimeout(() => history.replaceState(null, "", address()), 300);
};

// How each word of the address is taken; false where it means nothing here.
const WORDS = {
  suite: (text) => (state.suite = data.suites.findIndex((each) => each.name === text)) >= 0,
  a: (text) => Boolean(entryOf(text)) && ((state.a = text), true),
  b: (text) => Boolean(entryOf(text)) && ((state.b = text), true),
  scenario: (text) => (state.scenario = suite().scenarios.findIndex((each) => String(each.seed) === text)) >= 0,
  t: (text) => /^\d{1,4}(\.\d{1,3})?$/.test(text),
  kind: (text) => {
    const kinds = KINDS.filter((kind) => text.split(",").includes(kind));
    return kinds.join() === text && ((state.kinds = kinds), true);
  },
  action: (text) => ["", "k", "tau", "k+tau"].includes(text) && ((state.action = text), true),
  find: (text) => ((state.find = text.slice(0, 80)), true),
  sort: (text) => {
    const [, column, way] = /^(.*),(up|down)$/.exec(text) ?? [];
    return heads().some((head) => head.textContent === column) && ((state.sort = { column, down: way === "down" }), true);
  },
  limits: (text) => (state.limits = text === "on"),
};
const restore = () => {
  const words = new URLSearchParams(location.hash.slice(1));
  Object.assign(state, {
    suite: 0, a: "", b: "", scenario: 0, find: "", action: "", kinds: KINDS, sort: null, limits: false,
  });
  const lost = [];
  for (const [name, take] of Object.entries(WORDS)) {
    if (!words.has(name)) continue;
    if (!take(words.get(name))) lost.push(`${name} “${short(words.get(name), 40)}”`);
    for (const place of ["suite", "scenario"]) state[place] = Math.max(0, state[place]);
  }
  $("lost").textContent = lost.length
    ? `The address asks for what this page does not have: ${lost.join(", ")}. Shown instead is what is usual.` : "";
  const at = lost.some((each) => each.startsWith("t ")) ? null : words.get("t");
  return refresh({ at: at === null ? undefined : Number(at) });
};

// --- what answers to whom ---

const pick = (step) => {
  const n = suite().scenarios.length;
  return n ? choose((state.scenario + step + n) % n) : undefined;
};
const connectControls = () => {
  const groups = new Map();
  data.suites.forEach((each, i) => {
    const group = groups.get(each.environment) ?? make("optgroup", undefined, { label: each.environment });
    group.append(option(i, `${each.name} (${each.seeds.length} scenarios)`));
    groups.set(each.environment, group);
  });
  $("suite").replaceChildren(...groups.values());
  $("suite").onchange = guarded(() => {
    Object.assign(state, { suite: Number($("suite").value), scenario: 0 });
    return refresh();
  });
  for (const control of [$("action"), ...boxes]) control.onchange = guarded(filter);
  $("find").oninput = guarded(filter);
  for (const side of ["a", "b"])
    $(side).onchange = guarded(() => {
      state[side] = $(side).value;
      fillMenus();
      fillRanking();
      fillCompare();
      remember();
      return drill({ at: state.time, keepZoom: true });
    });
  $("scenario").onchange = guarded(() => choose(Number($("scenario").value)));
  $("previous").onclick = guarded(() => pick(-1));
  $("next").onclick = guarded(() => pick(1));
  $("time").oninput = guarded(() => setTime(Number($("time").value)));
  $("limits").onchange = guarded(() => { state.limits = $("limits").checked; fit(); remember(); });
  $("every").ontoggle = guarded(fillGains);
  document.querySelector("form").onsubmit = () => false;
};

const coarse = matchMedia("(pointer: coarse)");
const setTools = () => {
  // A finger that drags scrolls the page.
  for (const panel of panels)
    panel.toolbar.active_drag = coarse.matches ? null : panel.toolbar.tools.find((tool) => tool.name === "drag");
};
const connectCharts = () => {
  chart.compare.on_event("tap", guarded((event) => pickNearest(event.x)));
  for (const panel of panels) {
    for (const name of ["mousemove", "tap"]) panel.on_event(name, (event) => { if (state.table) setTime(event.x); });
    panel.on_event("doubletap", () => { const t = state.table.t; show(0, t[t.length - 1]); });
  }
  let due = 0;
  const refit = () => { cancelAnimationFrame(due); due = requestAnimationFrame(() => state.table && fit()); };
  time.properties.start.change.connect(refit);
  time.properties.end.change.connect(refit);
};

const repaint = () => { paint(); fillRanking(); };
const connectWindow = () => {
  matchMedia("(prefers-color-scheme: dark)").onchange = guarded(repaint);
  coarse.onchange = setTools;
  // A link within the page is not an address of a state.
  addEventListener("hashchange", guarded(() => (location.hash.includes("=") ? restore() : undefined)));
  let width = innerWidth;
  addEventListener("resize", guarded(() => { if (width !== innerWidth) { width = innerWidth; fillRanking(); } }));
  // Paper is white.
  addEventListener("beforeprint", guarded(() => { document.documentElement.dataset.print = "yes"; repaint(); }));
  addEventListener("afterprint", guarded(() => { delete document.documentElement.dataset.print; repaint(); }));
};

try {
  await Promise.all([buildCharts(), ...data.suites.map(unpackScores)]);
  addSortButtons();
  connectControls();
  connectCharts();
  paint();
  setTools();
  await restore();
  connectWindow();
  ready = true;
  document.documentElement.dataset.ready = "yes";
} catch (error) {
  document.documentElement.dataset.plain = "yes";
  complain(error);
}
