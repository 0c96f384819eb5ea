// The page's own script: fills the charts, which come without data and colours, and answers to the controls.
// Texts of entries only ever reach the page as text nodes, as options' texts, or as plain strings of a chart.
"use strict";
(async () => {
  const $ = (id) => document.getElementById(id);
  const read = (id) => JSON.parse($(id).textContent);
  const data = read("data");
  const state = { suite: 0, a: "", b: "", scenario: 0, time: 0, table: null };

  const make = (tag, text, settings = {}) => {
    const element = document.createElement(tag);
    if (text !== undefined) element.textContent = text;
    return Object.assign(element, settings);
  };
  const option = (value, text) => make("option", text, { value });
  // A chart takes "$$…$$" and the like for mathematics, and would want to load a typesetter.
  const plain = (text) => String(text).replace(/[$\\]/g, (sign) => sign + "\u2060");
  const short = (text, n) => (text.length > n ? text.slice(0, n - 1) + "…" : text);
  const suite = () => data.suites[state.suite];
  const entryOf = (name) => suite().entries.find((entry) => entry.name === name);
  const title = (entry) =>
    entry.n_runs > 1 ? `${entry.name} (training seed ${entry.training_seed})` : entry.name;

  // --- charts --------------------------------------------------------------------------------------------------------

  const json = read("charts");
  const names = {};
  for (const root of json.roots) names[root.attributes.name] = root.id;
  for (const panel of data.panels) {
    const chart = make("div", undefined, { id: `panel-${panel.name}`, className: "chart" });
    chart.setAttribute("role", "img");
    chart.setAttribute("aria-label", `${panel.title} over time; the table of values holds the numbers`);
    $("panels").append(chart);
  }
  const roots = {};
  for (const [name, id] of Object.entries(names)) roots[id] = $(name);
  await Bokeh.embed.embed_items({ page: json }, [{ docid: "page", roots, root_ids: Object.keys(roots) }]);
  const doc = Bokeh.documents[Bokeh.documents.length - 1];
  const chart = {};
  for (const root of doc.roots()) chart[root.name] = root;
  const sources = {};
  for (const root of doc.roots())
    for (const renderer of root.renderers)
      if (renderer.data_source) sources[renderer.data_source.name] = renderer.data_source;
  const panels = data.panels.map((panel) => chart[`panel-${panel.name}`]);
  const time = panels[0].x_range;
  const cursor = panels[0].center.find((each) => each.name === "cursor");

  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const INKS = { a: "a", b: "b", rest: "rest", axis: "soft", ink: "ink", event: "event", wind: "wind", rule: "soft" };

  const paint = () => {
    const dim = ink("soft");
    for (const root of doc.roots()) {
      if (root.title) root.title.text_color = ink("ink");
      for (const side of ["above", "below", "left", "right"])
        for (const each of root[side])
          if (each.axis_label_text_color !== undefined)
            each.setv({
              axis_label_text_color: dim, axis_label_text_font_style: "normal", major_label_text_color: dim,
              axis_line_color: ink("line"), major_tick_line_color: each.major_tick_line_color && ink("line"),
              minor_tick_line_color: null,
            });
      for (const each of root.center) {
        if (each.grid_line_color !== undefined) each.grid_line_color = ink("grid");
        if (each.tags.includes("rule")) each.line_color = dim;
        if (each.tags.includes("cursor")) each.line_color = ink("ink");
      }
      for (const renderer of root.renderers) {
        const tag = renderer.tags.find((each) => each in INKS) ?? renderer.glyph.tags.find((each) => each in INKS);
        if (!tag) continue;
        const glyph = renderer.glyph;
        const hollow = renderer.tags.includes("hollow") || glyph.tags.includes("hollow");
        const colour = ink(INKS[tag]);
        if (glyph.text_color !== undefined) glyph.text_color = colour;
        else if (hollow) glyph.setv({ line_color: colour, fill_color: ink("page"), fill_alpha: tag === "event" ? 0 : 1 });
        else glyph.line_color = colour;
      }
    }
    fillRanking();
  };

  // --- ranking -------------------------------------------------------------------------------------------------------

  const shown = () => {
    const kinds = [...document.querySelectorAll("input[name=kind]:checked")].map((box) => box.value);
    const action = $("action").value;
    return suite().entries.filter((entry) => kinds.includes(entry.kind) && (!action || entry.action === action));
  };
  const tone = (name) => (name === state.a ? "a" : name === state.b ? "b" : "rest");

  const fillRanking = () => {
    const entries = shown();
    const n = entries.length;
    const colour = (entry) => ({ a: ink("a"), b: ink("b"), rest: ink("soft") })[tone(entry.name)];
    const y = (entry) => n - 1 - entries.indexOf(entry);
    const range = (values) => {
      const span = Math.max(...values) - Math.min(...values) || 1;
      return { start: Math.min(...values) - 0.05 * span, end: Math.max(...values) + 0.05 * span };
    };
    chart.ranking.setv({ height: 60 + 24 * Math.max(n, 3) });
    chart.ranking.y_range.setv({ start: -0.7, end: n - 0.3 });
    if (n) chart.ranking.x_range.setv(range([0, 100, ...entries.flatMap((entry) => entry.score)]));
    sources.intervals.data = {
      y: entries.map(y), low: entries.map((e) => e.score[1]), high: entries.map((e) => e.score[2]),
      colour: entries.map(colour),
    };
    for (const kind of ["law", "feedback", "learned"]) {
      const own = entries.filter((entry) => entry.kind === kind);
      sources[`dots-${kind}`].data = {
        x: own.map((e) => e.score[0]), y: own.map(y), name: own.map((e) => plain(e.name)), colour: own.map(colour),
        interval: own.map((e) => `${e.score[0].toFixed(1)} (${e.score[1].toFixed(1)} … ${e.score[2].toFixed(1)})`),
      };
    }
    const narrow = innerWidth < 600;
    const labels = new Map(entries.map((entry) => [y(entry), plain(short(entry.name, narrow ? 22 : 30))]));
    const axis = chart.ranking.left[0];
    axis.ticker.ticks = [...labels.keys()];
    axis.major_label_overrides = labels;

    const groups = { a: [], b: [], rest: [] };
    for (const entry of entries) groups[tone(entry.name)].push(entry);
    const { low, step } = suite().profile;
    const bounds = data.metrics.map((metric, i) => {
      const values = entries.map((entry) => entry.physical[i]);
      const least = Math.min(...values), most = Math.max(...values);
      return metric.up ? { worst: least, best: most } : { worst: most, best: least };
    });
    const place = (value, { worst, best }) => (best === worst ? 1 : (value - worst) / (best - worst));
    for (const [tag, own] of Object.entries(groups)) {
      const name = own.map((entry) => plain(entry.name));
      sources[`profile-${tag}`].data = {
        xs: own.map((entry) => entry.above.map((_, i) => low + step * i)), ys: own.map((entry) => entry.above), name,
      };
      sources[`physical-${tag}`].data = {
        xs: own.map((entry) => entry.physical.map((_, i) => i)),
        ys: own.map((entry) => entry.physical.map((value, i) => place(value, bounds[i]))), name,
      };
    }
    const longest = Math.max(0, ...suite().entries.map((entry) => entry.above.length));
    chart.profile.x_range.setv({ start: low, end: low + step * longest });
    const digits = (value) => (n ? Number(value.toPrecision(Math.abs(value) > 40 && Math.abs(value) < 60 ? 5 : 3)).toString() : "");
    sources.axes.data = {
      x: data.metrics.map((_, i) => i), best: bounds.map((each) => digits(each.best)),
      worst: bounds.map((each) => digits(each.worst)),
    };

    for (const table of document.querySelectorAll("table[data-suite]")) {
      const place = [...table.parentNode.querySelectorAll("table[data-suite]")].indexOf(table);
      table.hidden = place !== state.suite;
      for (const row of table.tBodies[0].rows) {
        row.hidden = !entries.some((entry) => entry.name === row.dataset.name);
        row.className = tone(row.dataset.name);
      }
    }
    $("shown").textContent = `${n} of ${suite().entries.length} entries shown.`;
  };

  // --- traces --------------------------------------------------------------------------------------------------------

  const inflate = async (text) => {
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // Rows of whole numbers: all low bytes, then all high bytes, of the differences along a row.
  const unpack = async (scenario) => {
    const bytes = await inflate(scenario.packed);
    const half = bytes.length / 2, n = scenario.n;
    const rows = [];
    for (let first = 0; first < half; first += n) {
      const row = new Int16Array(n);
      let sum = 0;
      for (let i = 0; i < n; i++) row[i] = sum = (sum + (bytes[first + i] | (bytes[half + first + i] << 8))) & 0xffff;
      rows.push(row);
    }
    return rows;
  };
  const numbers = (row, step, offset = 0) =>
    Float64Array.from(row, (value) => (value === data.missing ? NaN : offset + value * step));

  const traces = async () => {
    const scenario = suite().scenarios[state.scenario];
    const rows = await unpack(scenario);
    const groups = suite().groups.length;
    const wind = rows.slice(0, groups).map((row) => numbers(row, data.wind_step));
    const perEntry = data.series.reduce((sum, each) => sum + (each.name === "frequency" ? 1 : groups), 0);
    const table = { t: Float64Array.from({ length: scenario.n }, (_, i) => Math.round(i * scenario.step * 1e4) / 1e4) };
    const columns = Object.keys(sources.traces.data).filter((name) => name !== "t");
    for (const name of columns) table[name] = new Float64Array(scenario.n).fill(NaN);
    for (const side of ["a", "b"]) {
      wind.forEach((values, j) => (table[`${side}-wind-${j}`] = values));
      const place = suite().traced.indexOf(state[side]);
      if (place < 0) continue;
      let row = groups + place * perEntry;
      for (const each of data.series)
        for (let j = 0; j < (each.name === "frequency" ? 1 : groups); j++)
          table[`${side}-${each.name}-${j}`] = numbers(rows[row++], each.step, each.name === "frequency" ? data.nominal : 0);
      for (let j = 0; j < groups; j++)
        table[`${side}-ratio-${j}`] = table[`${side}-rotor-${j}`].map((speed, i) => (data.tip_speed * speed) / wind[j][i]);
    }
    return table;
  };

  const events = () => suite().scenarios[state.scenario].events;

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
      y0: list.map(([bus]) => at(bus)[1]), text: list.map(([, text]) => text), kind: list.map(([, text]) => text),
    });
    sources.units.data = unit(machines.map(([bus, kind]) => [bus, kind, -0.35]));
    const { kind, ...groups } = unit(suite().groups.map((bus, j, every) => {
      const beside = every.filter((other) => other === bus).length;
      const place = every.slice(0, j).filter((other) => other === bus).length;
      return [bus, `W${j + 1}`, 0.8 * (place - (beside - 1) / 2)];
    }));
    sources.groups.data = groups;
    const struck = new Map();
    events().forEach((event, i) => {
      for (const bus of event.buses) struck.set(bus, [...(struck.get(bus) ?? []), i + 1]);
    });
    sources.struck.data = {
      x: [...struck.keys()].map((bus) => at(bus)[0]), y: [...struck.keys()].map((bus) => at(bus)[1]),
      text: [...struck.values()].map((list) => list.join(", ")),
    };
    const where = [...struck.keys()].map((bus) => `bus ${bus}`).join(", ") || "no bus";
    $("grid").setAttribute("aria-label",
      `Single-line diagram of the 14-bus system: machines at buses ${machines.map(([bus]) => bus).join(", ")}, ` +
      `wind turbine groups at bus ${[...new Set(suite().groups)].join(", ")}; events strike ${where}.`);
  };

  const fit = () => {
    // Every panel shows what lies in the chosen time, with a margin.
    for (const [i, panel] of data.panels.entries()) {
      let low = Infinity, high = -Infinity;
      const t = state.table.t;
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

  const UNITS = { frequency: 3, rocof: 3, rotor: 3, ratio: 2, power: 3, k: 3, tau: 2, wind: 1 };
  const fillValues = () => {
    const i = Math.min(Math.round(state.time / suite().scenarios[state.scenario].step), state.table.t.length - 1);
    cursor.location = state.time;
    $("now").textContent = `${state.time.toFixed(1)} s`;
    const head = make("tr");
    for (const text of ["quantity", "A", "B"]) {
      const cell = make("th", text, { scope: "col" });
      if (text !== "quantity") cell.className = `number ${text.toLowerCase()}-ink`;
      head.append(cell);
    }
    const body = [];
    for (const panel of data.panels)
      for (let j = 0; j < (panel.own ? suite().groups.length : 1); j++) {
        const row = make("tr");
        row.append(make("th", panel.own ? panel.title.replace(" [", ` W${j + 1} [`) : panel.title, { scope: "row" }));
        for (const side of ["a", "b"]) {
          const value = state.table[`${side}-${panel.name}-${j}`][i];
          row.append(make("td", Number.isFinite(value) ? value.toFixed(UNITS[panel.name]) : "–", { className: "number" }));
        }
        body.push(row);
      }
    const thead = make("thead"), tbody = make("tbody");
    thead.append(head);
    tbody.append(...body);
    $("values").replaceChildren(thead, tbody);
  };
  const setTime = (value) => {
    const { n, step } = suite().scenarios[state.scenario];
    state.time = Math.min(Math.max(0, Math.round(value / step) * step), (n - 1) * step);
    $("time").value = state.time;
    $("time").setAttribute("aria-valuetext", `${state.time.toFixed(1)} s`);
    fillValues();
  };

  const swatch = (dashes) => {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
    for (const [key, value] of Object.entries({ width: 28, height: 10, "aria-hidden": "true" })) svg.setAttribute(key, value);
    for (const [key, value] of Object.entries({
      x1: 0, x2: 28, y1: 5, y2: 5, stroke: "currentColor", "stroke-width": 2, "stroke-dasharray": dashes.join(" "),
    })) line.setAttribute(key, value);
    svg.append(line);
    return svg;
  };
  const fillLegend = () => {
    const items = [];
    const add = (tag, dashes, text) => {
      const item = make("li", undefined, { className: `${tag}-ink` });
      item.append(swatch(dashes), text);
      items.push(item);
    };
    const failures = suite().scenarios[state.scenario].failures;
    for (const side of ["a", "b"]) {
      const mark = side.toUpperCase(), failure = failures[state[side]];
      suite().groups.forEach((_, j) =>
        add(side, data.dashes[j % data.dashes.length], j ? `${mark}, W${j + 1}` : `${mark}: ${state[side]}, W1`));
      if (failure) items.push(make("li", `✕ ${mark}: ${failure[0]} at ${failure[1]} s`, { className: `${side}-ink` }));
    }
    add("wind", [], "wind");
    add("event", [3, 3], "event");
    $("legend").replaceChildren(...items);
  };

  const fillCards = () => {
    const scenario = suite().scenarios[state.scenario];
    const cards = ["a", "b"].map((side) => {
      const entry = entryOf(state[side]);
      const card = make("div", undefined, { className: "card" });
      card.append(make("h3", `${side.toUpperCase()}: ${title(entry)}`, { className: `${side}-ink` }));
      const failure = scenario?.failures[entry.name];
      const score = entry.scenario_scores[state.scenario];
      card.append(make("p", `Score in this scenario: ${score}` + (failure ? `; failed: ${failure[0]} after ${failure[1]} s` : "")));
      card.append(make("p", `${entry.kind}${entry.action ? `, acts on ${entry.action}, sees ${entry.observation}` : ""}; rank ${entry.rank} of ${suite().entries.length}`));
      for (const text of [entry.description, entry.equation, entry.source]) if (text) card.append(make("p", text, { className: "note" }));
      if (!suite().traced.includes(entry.name)) card.append(make("p", "No traces of this entry are in the file.", { className: "note" }));
      return card;
    });
    $("cards").replaceChildren(...cards);
  };

  let asked = 0;
  const drill = async ({ keepTime = false } = {}) => {
    const own = ++asked;
    const scenario = suite().scenarios[state.scenario];
    const missing = !scenario || !suite().traced.length;
    $("traces").hidden = missing;
    $("none").hidden = !missing;
    $("none").textContent = "This file holds no traces of this suite.";
    if (missing) return;
    const table = await traces();
    // A later choice has overtaken this one.
    if (own !== asked) return;
    state.table = table;
    const end = table.t[table.t.length - 1];
    sources.traces.data = table;
    sources.events.data = { x: events().map((event) => event.time) };
    $("time").max = end;
    $("time").step = scenario.step;
    if (!keepTime) show(0, end);
    fit();
    setTime(keepTime ? state.time : events()[0]?.time ?? 0);
    drawGrid();
    $("facts").textContent = `${scenario.name}: ${scenario.facts}.`;
    $("events").replaceChildren(...(events().length ? events().map((event) => make("li", `${event.time} s: ${event.text}`)) : [make("li", "none but the wind")]));
    $("zooms").replaceChildren(...events().map((event, i) => {
      const button = make("button", `Event ${i + 1}`, { type: "button" });
      button.setAttribute("aria-label", `Show 12 seconds around event ${i + 1}`);
      button.onclick = () => { show(Math.max(0, event.time - 2), Math.min(end, event.time + 10)); setTime(event.time); };
      return button;
    }));
    $("whole").onclick = () => show(0, end);
    fillLegend();
    fillCards();
  };

  // --- controls ------------------------------------------------------------------------------------------------------

  const fillNames = () => {
    const entries = suite().entries;
    const keep = (name, other) => (entries.some((entry) => entry.name === name) ? name : other);
    const best = entries.find((entry) => entry.name !== data.reference && suite().traced.includes(entry.name)) ?? entries[0];
    state.a = keep(state.a, best.name);
    state.b = keep(state.b, keep(data.reference, entries[1].name));
    for (const side of ["a", "b"]) {
      $(side).replaceChildren(...entries.map((entry) => option(entry.name, `${entry.rank}. ${entry.name}`)));
      $(side).value = state[side];
    }
    $("scenario").replaceChildren(...suite().scenarios.map((scenario, i) => {
      const what = scenario.events.map((event) => `${event.text}`).join("; ") || "wind alone";
      return option(i, short(`${scenario.seed}: ${what}`, 90));
    }));
    $("scenario").value = state.scenario = 0;
    $("about").textContent = `${suite().name}: ${suite().description}`;
    const versions = Object.entries(suite().versions).map(([name, version]) => `${name} ${version}`).join(", ");
    $("made").textContent = `Suite ${suite().hash.slice(0, 12)}, source ${suite().source.slice(0, 12)}; ${versions}.`;
  };
  const guarded = (action) => (...values) => Promise.resolve(action(...values)).catch(complain);
  const complain = (error) => {
    $("problem").hidden = false;
    $("problem").textContent = `Something went wrong: ${error.message}`;
    console.error(error);
  };
  const pick = (step) => {
    const n = suite().scenarios.length;
    if (n) $("scenario").value = state.scenario = (state.scenario + step + n) % n;
    return drill();
  };

  $("suite").replaceChildren(...data.suites.map((each, i) => option(i, `${each.name} (${each.n_scenarios} scenarios)`)));
  $("suite").onchange = guarded(() => { state.suite = Number($("suite").value); fillNames(); fillRanking(); return drill(); });
  $("action").onchange = guarded(fillRanking);
  for (const box of document.querySelectorAll("input[name=kind]")) box.onchange = guarded(fillRanking);
  for (const side of ["a", "b"])
    $(side).onchange = guarded(() => { state[side] = $(side).value; fillRanking(); return drill({ keepTime: true }); });
  $("scenario").onchange = guarded(() => { state.scenario = Number($("scenario").value); return drill(); });
  $("previous").onclick = guarded(() => pick(-1));
  $("next").onclick = guarded(() => pick(1));
  $("time").oninput = guarded(() => setTime(Number($("time").value)));
  document.querySelector("form").onsubmit = () => false;

  const coarse = matchMedia("(pointer: coarse)");
  const setTools = () => {
    // A finger that drags scrolls the page.
    for (const panel of panels)
      panel.toolbar.active_drag = coarse.matches ? null : panel.toolbar.tools.find((tool) => tool.name === "drag");
  };
  for (const panel of panels) {
    for (const name of ["mousemove", "tap"]) panel.on_event(name, (event) => { if (state.table) setTime(event.x); });
    panel.on_event("doubletap", () => { const t = state.table.t; show(0, t[t.length - 1]); });
  }
  let due = 0;
  const refit = () => { cancelAnimationFrame(due); due = requestAnimationFrame(() => state.table && fit()); };
  time.properties.start.change.connect(refit);
  time.properties.end.change.connect(refit);

  try {
    fillNames();
    paint();
    setTools();
    await drill();
    matchMedia("(prefers-color-scheme: dark)").onchange = guarded(paint);
    coarse.onchange = setTools;
    let width = innerWidth;
    addEventListener("resize", guarded(() => { if (width !== innerWidth) { width = innerWidth; fillRanking(); } }));
    document.documentElement.dataset.ready = "yes";
  } catch (error) {
    complain(error);
  }
})();
