// --- one scenario, two entries: the grid, the traces, and the values at the cursor ------------------------------------

const traces = async () => {
  // Of what is chosen now: while the rows are unpacked it may change.
  const { n, step, packed } = scenario(), groups = suite().groups.length;
  const places = { a: suite().traced.indexOf(state.a), b: suite().traced.indexOf(state.b) };
  const rows = await unpack(packed, n);
  const wind = rows.slice(0, groups).map((row) => numbers(row, data.wind_step));
  const lines = (each) => (each.name === "frequency" ? 1 : groups);
  const perEntry = data.series.reduce((sum, each) => sum + lines(each), 0);
  const table = { t: Float64Array.from({ length: n }, (_, i) => Math.round(i * step * 1e4) / 1e4) };
  for (const name of Object.keys(sources.traces.data)) table[name] ??= new Float64Array(n).fill(NaN);
  for (const side of ["a", "b"]) {
    wind.forEach((values, j) => (table[`${side}-wind-${j}`] = values));
    if (places[side] < 0) continue;
    let row = groups + places[side] * perEntry;
    for (const each of data.series)
      for (let j = 0; j < lines(each); j++)
        table[`${side}-${each.name}-${j}`] = numbers(rows[row++], each.step, each.name === "frequency" ? data.nominal : 0);
    for (let j = 0; j < groups; j++)
      table[`${side}-ratio-${j}`] = table[`${side}-rotor-${j}`].map((speed, i) => (data.tip_speed * speed) / wind[j][i]);
  }
  return table;
};
const events = () => scenario().events;

const drawGrid = () => {
  const { buses, branches, machines } = data.case;
  const at = (bus) => buses[bus];
  const opened = events().filter((event) => event.buses.length === 2).map((event) => event.buses.join());
  const ends = (pairs) => ({
    x0: pairs.map(([from]) => at(from)[0]), y0: pairs.map(([from]) => at(from)[1]),
    x1: pairs.map(([, to]) => at(to)[0]), y1: pairs.map(([, to]) => at(to)[1]),
  });
  const isOpened = ([from, to]) => opened.includes(`${from},${to}`) || opened.includes(`${to},${from}`);
  sources.branches.data = ends(branches.filter((pair) => !isOpened(pair)));
  sources.opened.data = ends(branches.filter(isOpened));
  const all = Object.entries(buses);
  sources.buses.data = {
    x0: all.map(([, [x]]) => x - 0.45), x1: all.map(([, [x]]) => x + 0.45), y: all.map(([, [, y]]) => y),
    x: all.map(([, [x]]) => x), number: all.map(([number]) => number),
  };
  const unit = (list) => ({
    x: list.map(([bus, , dx]) => at(bus)[0] + dx), y: list.map(([bus]) => at(bus)[1] - 0.85),
    y0: list.map(([bus]) => at(bus)[1]), text: list.map(([, text]) => text),
  });
  sources.units.data = unit(machines.map(([bus, kind]) => [bus, kind, -0.35]));
  sources.groups.data = unit(suite().groups.map((bus, j, every) => {
    const beside = every.filter((other) => other === bus).length;
    const place = every.slice(0, j).filter((other) => other === bus).length;
    return [bus, `W${j + 1}`, 0.8 * (place - (beside - 1) / 2)];
  }));
  const struck = new Map();
  events().forEach((event, i) => {
    for (const bus of event.buses) struck.set(bus, [...(struck.get(bus) ?? []), i + 1]);
  });
  const places = [...struck.keys()];
  sources.struck.data = {
    x: places.map((bus) => at(bus)[0]), y: places.map((bus) => at(bus)[1]),
    text: [...struck.values()].map((list) => list.join(", ")),
  };
  $("grid").setAttribute("aria-label",
    `Single-line diagram of the 14-bus system: machines at buses ${machines.map(([bus]) => bus).join(", ")}, ` +
    `wind turbine groups at bus ${[...new Set(suite().groups)].join(", ")}; ` +
    `events strike ${places.map((bus) => `bus ${bus}`).join(", ") || "no bus"}.`);
};

const fit = () => {
  // Every panel shows what lies in the chosen time, with a margin, and the limits where they are asked for.
  const t = state.table.t;
  for (const [i, panel] of data.panels.entries()) {
    const limits = state.limits ? Object.values(suite().limits[panel.name] ?? {}) : [];
    let low = Math.min(...limits), high = Math.max(...limits);
    for (const [name, values] of Object.entries(state.table))
      if (name.split("-")[1] === panel.name)
        for (let k = 0; k < values.length; k++)
          if (t[k] >= time.start && t[k] <= time.end && Number.isFinite(values[k])) {
            low = Math.min(low, values[k]);
            high = Math.max(high, values[k]);
          }
    if (low > high) [low, high] = [0, 1];
    const margin = 0.08 * (high - low) || 0.1 * Math.abs(high) || 0.1;
    panels[i].y_range.setv({ start: low - margin, end: high + margin });
  }
};
const show = (start, end) => time.setv({ start, end });

const DIGITS = { frequency: 3, rocof: 3, rotor: 3, ratio: 2, power: 3, k: 3, tau: 2, wind: 1 };
// Heads and columns of all that the panels show.
const quantities = () => data.panels.flatMap((panel) =>
  Array.from({ length: panel.own ? suite().groups.length : 1 }, (_, j) => ({
    name: panel.name, column: `${panel.name}-${j}`,
    head: panel.own ? panel.title.replace(" [", ` W${j + 1} [`) : panel.title,
  })));
const fillValues = () => {
  const i = Math.min(Math.round(state.time / scenario().step), state.table.t.length - 1);
  cursor.location = state.time;
  $("now").textContent = `${state.time.toFixed(1)} s`;
  const value = (side, { name, column }) => {
    const number = state.table[`${side}-${column}`][i];
    return Number.isFinite(number) ? number.toFixed(DIGITS[name]) : "–";
  };
  fillTable($("values"), ["quantity", "A", "B"],
    quantities().map((each) => [each.head, value("a", each), value("b", each)]));
  $("values").tHead.rows[0].cells[1].classList.add("a-ink");
  $("values").tHead.rows[0].cells[2].classList.add("b-ink");
};
offer("run", () => `wtg_gym-${suite().name}-${scenario().seed}.csv`, "text/csv", () => {
  const columns = quantities().flatMap(({ column }) => ["a", "b"].map((side) => `${side}-${column}`));
  const rows = [...state.table.t].map((t, i) =>
    [t, ...columns.map((name) => (Number.isFinite(state.table[name][i]) ? +state.table[name][i].toFixed(4) : ""))]);
  return csv([["time_s", ...columns], ...rows]);
});
const setTime = (value) => {
  const { n, step } = scenario();
  state.time = Math.min(Math.max(0, Math.round(value / step) * step), (n - 1) * step);
  $("time").value = state.time;
  $("time").setAttribute("aria-valuetext", `${state.time.toFixed(1)} s`);
  fillValues();
  remember();
};

const drawing = (tag, settings, ...children) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(settings)) element.setAttribute(key, value);
  element.append(...children);
  return element;
};
const swatch = (dashes, width) =>
  drawing("svg", { width: 28, height: 10, "aria-hidden": "true" }, drawing("line", {
    x1: 0, x2: 28, y1: 5, y2: 5, stroke: "currentColor", "stroke-width": width, "stroke-dasharray": dashes.join(" "),
  }));
const failureOf = (side) => {
  const failure = scenario()?.failures[state[side]];
  return failure && `${failure[0]} after ${failure[1]} s`;
};
const fillLegend = () => {
  const items = [];
  const add = (tag, dashes, text, width = 2) => {
    const item = make("li", undefined, { className: `${tag}-ink` });
    item.append(swatch(dashes, width), text);
    items.push(item);
  };
  for (const side of ["a", "b"]) {
    const mark = side.toUpperCase();
    suite().groups.forEach((_, j) => add(side, data.dashes[j % data.dashes.length],
      j ? `${mark}, W${j + 1}` : `${mark}: ${state[side]}, W1`, side === "a" ? 3 : 1.5));
    if (failureOf(side)) items.push(make("li", `✕ ${mark}: ${failureOf(side)}`, { className: `${side}-ink` }));
  }
  add("wind", [], "wind");
  add("event", [3, 3], "event");
  $("legend").replaceChildren(...items);
};
const fillRules = () => {
  const units = Object.fromEntries(data.panels.map((panel) => [panel.name, /\[(.*)\]/.exec(panel.title)[1].replace("–", "")]));
  for (const [name, each] of Object.entries(suite().limits))
    Object.values(each).forEach((value, i) => {
      chart[`panel-${name}`].center.find((line) => line.name === `limit-${i}`).location = value;
    });
  $("rules").textContent = Object.entries(suite().limits).flatMap(([name, each]) =>
    Object.entries(each).map(([what, value]) => `${what} (${Number(value.toPrecision(4))} ${units[name]}`.trim() + ")")).join(", ");
};

const fillCards = () => {
  const cards = ["a", "b"].map((side) => {
    const entry = entryOf(state[side]);
    const card = make("div", undefined, { className: "card" });
    card.append(make("h3", `${side.toUpperCase()}: ${title(entry)}`, { className: `${side}-ink` }));
    const score = entry.runs[entry.traced_run][state.scenario].toFixed(1), failure = failureOf(side);
    card.append(make("p", `Score in this scenario: ${score}` + (failure ? `; failed: ${failure}` : "")));
    card.append(make("p", entry.kind + (entry.action ? `, acts on ${entry.action}, sees ${entry.observation}` : "") +
      `; rank ${entry.rank} of ${suite().entries.length}`));
    for (const text of [entry.description, entry.equation, entry.source])
      if (text) card.append(make("p", text));
    if (!suite().traced.includes(entry.name)) card.append(make("p", "No traces of this entry are in the file."));
    return card;
  });
  $("cards").replaceChildren(...cards);
};

const fillEvents = (end) => {
  $("events").replaceChildren(...events().map((event) => make("li", `${event.time} s: ${event.text}`)));
  if (!events().length) $("events").append(make("li", "none but the wind"));
  $("zooms").replaceChildren(...events().map((event, i) => {
    const button = make("button", `Event ${i + 1}`, { type: "button" });
    button.setAttribute("aria-label", `Event ${i + 1}: show 12 seconds around it`);
    button.onclick = guarded(() => {
      show(Math.max(0, event.time - 2), Math.min(end, event.time + 10));
      setTime(event.time);
    });
    return button;
  }));
};

let asked = 0;
// Shows the chosen scenario; the cursor goes to its first event, or to a time, and the part shown stays where asked.
const drill = async ({ at, keepZoom = false } = {}) => {
  const own = ++asked;
  const missing = !scenario() || !suite().traced.length;
  $("traces").hidden = missing;
  $("none").hidden = !missing;
  $("none").textContent = "This file holds no traces of this suite.";
  state.table = missing ? null : state.table;
  if (missing) return;
  const table = await traces();
  // A later choice has overtaken this one.
  if (own !== asked) return;
  state.table = table;
  const end = table.t[table.t.length - 1];
  sources.traces.data = table;
  sources.events.data = { x: events().map((event) => event.time) };
  $("time").max = end;
  $("time").step = scenario().step;
  if (!keepZoom) show(0, end);
  fit();
  setTime(at ?? events()[0]?.time ?? 0);
  drawGrid();
  $("facts").textContent = `${scenario().name}: ${scenario().facts}.`;
  $("whole").onclick = guarded(() => show(0, end));
  fillEvents(end);
  fillLegend();
  fillCards();
};
