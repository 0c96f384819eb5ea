// What everything else builds on: the data, the state, small helpers, and the charts, which come without data and colours.
// All of the page's scripts share one scope. Texts of entries only ever reach the page as text nodes, as options' texts,
// as values of inputs, or as plain strings of a chart.

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const state = {
  suite: 0, a: "", b: "", scenario: 0, time: 0, table: null, find: "", action: "", kinds: [], sort: null, limits: false,
};

const make = (tag, text, settings = {}) => {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  return Object.assign(element, settings);
};
const option = (value, text) => make("option", text, { value });
// A chart takes "$$…$$" and the like for mathematics, and would want to load a typesetter.
const plain = (text) => String(text).replace(/[$\\]/g, (sign) => sign + "\u2060");
const short = (text, n) => (text.length > n ? text.slice(0, n - 1) + "…" : text);
const signed = (value) => `${value > 0 ? "+" : ""}${value.toFixed(1)}`;
const suite = () => data.suites[state.suite];
const scenario = () => suite().scenarios[state.scenario];
const entryOf = (name) => suite().entries.find((entry) => entry.name === name);
const tone = (name) => (name === state.a ? "a" : name === state.b ? "b" : "rest");
const title = (entry) => (entry.n_runs > 1 ? `${entry.name} (training seed ${entry.training_seed})` : entry.name);

const complain = (error) => {
  $("problem").hidden = false;
  $("problem").textContent = `Something went wrong: ${error.message}`;
  console.error(error);
};
const guarded = (action) => (...values) =>
  new Promise((resolve) => resolve(action(...values))).catch(complain);

// Fills a table whose first column heads the rows; a cell is a text or an element.
const fillTable = (table, heads, rows) => {
  const row = (cells, head) => {
    const line = make("tr");
    line.append(...cells.map((content, i) => {
      const cell = make(head || !i ? "th" : "td", undefined, { className: i ? "number" : "" });
      if (head || !i) cell.scope = head ? "col" : "row";
      cell.append(content);
      return cell;
    }));
    return line;
  };
  const thead = make("thead"), tbody = make("tbody");
  thead.append(row(heads, true));
  tbody.append(...rows.map((cells) => row(cells, false)));
  table.replaceChildren(thead, tbody);
};

// A spreadsheet takes a text that begins like a formula for one.
const csv = (rows) =>
  rows.map((row) => row.map((value) => {
    const text = typeof value === "string" && /^[=+\-@\t]/.test(value) ? `'${value}` : String(value ?? "");
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  }).join(",")).join("\n") + "\n";
// The link gets its content when it is used.
const offer = (id, name, type, content) => {
  $(id).href = "data:,";
  $(id).onclick = () => {
    $(id).download = name();
    $(id).href = `data:${type};charset=utf-8,${encodeURIComponent(content())}`;
  };
};

// --- packed numbers and texts ----------------------------------------------------------------------------------------

const inflate = async (text) => {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
const inflated = async (id) => new TextDecoder().decode(await inflate($(id).textContent));

// Rows of n whole numbers: all low bytes, then all high bytes, of the differences along a row, folded to be positive.
const unpack = async (packed, n) => {
  const bytes = await inflate(packed);
  const half = bytes.length / 2;
  const rows = [];
  for (let first = 0; first < half; first += n) {
    const row = new Int16Array(n);
    for (let i = 0, sum = 0; i < n; i++) {
      const folded = bytes[first + i] | (bytes[half + first + i] << 8);
      row[i] = sum = sum + ((folded >> 1) ^ -(folded & 1));
    }
    rows.push(row);
  }
  return rows;
};
const numbers = (row, step, offset = 0) =>
  Float64Array.from(row, (value) => (value === data.missing ? NaN : offset + value * step));

// Gives every entry the scores of its runs, and their mean by scenario; and the suite the intervals of differences.
const unpackScores = async (each) => {
  const rows = await unpack(each.scores, each.seeds.length);
  each.lower = (await unpack(each.differences, each.entries.length)).map((row) => numbers(row, data.score_step));
  let next = 0;
  each.entries.forEach((entry, place) => {
    entry.place = place;
    entry.runs = rows.slice(next, (next += entry.n_runs)).map((row) => numbers(row, data.score_step));
    entry.mean = each.seeds.map((_, i) => entry.runs.reduce((sum, run) => sum + run[i], 0) / entry.n_runs);
  });
};

// --- charts ----------------------------------------------------------------------------------------------------------

if (!("DecompressionStream" in window)) {
  complain(new Error("this browser is too old for the charts, which Chrome 80, Firefox 113 and Safari 16.4 can show"));
  return;
}
delete document.documentElement.dataset.plain;

// A chart takes no keys, so that it is no stop on the way through the page.
const leaveOut = (place) => {
  for (const each of place.querySelectorAll("*")) {
    if (each.tabIndex >= 0) each.tabIndex = -1;
    if (each.shadowRoot) leaveOut(each.shadowRoot);
  }
};

const chart = {}, sources = {};
let doc, panels, time, cursor;
const buildCharts = async () => {
  // The policy knows the library's hash, so that it runs as a script of this page.
  document.head.append(make("script", await inflated("library")));
  const json = JSON.parse(await inflated("charts"));
  for (const panel of data.panels) {
    const place = make("div", undefined, { id: `panel-${panel.name}`, className: "chart" });
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", `${panel.title} over time; the table of values holds the numbers`);
    $("panels").append(place);
  }
  const roots = {};
  for (const root of json.roots) roots[root.id] = $(root.attributes.name);
  await Bokeh.embed.embed_items({ page: json }, [{ docid: "page", roots, root_ids: Object.keys(roots) }]);
  for (const place of document.querySelectorAll(".chart")) leaveOut(place);
  doc = Bokeh.documents[Bokeh.documents.length - 1];
  for (const root of doc.roots()) {
    chart[root.name] = root;
    for (const renderer of root.renderers)
      if (renderer.data_source) sources[renderer.data_source.name] = renderer.data_source;
  }
  panels = data.panels.map((panel) => chart[`panel-${panel.name}`]);
  time = panels[0].x_range;
  cursor = panels[0].center.find((each) => each.name === "cursor");
};

const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const INKS = { a: "a", b: "b", rest: "rest", axis: "soft", ink: "ink", event: "event", wind: "wind" };

const paintAxis = (axis) =>
  axis.setv({
    axis_label_text_color: ink("soft"), axis_label_text_font_style: "normal", major_label_text_color: ink("soft"),
    axis_line_color: ink("line"), major_tick_line_color: axis.major_tick_line_color && ink("line"),
    minor_tick_line_color: null,
  });
const paintGlyph = (glyph, tag, tags) => {
  const colour = ink(INKS[tag]);
  if (glyph.text_color !== undefined) glyph.text_color = colour;
  else if (tags.includes("filled")) glyph.fill_color = colour;
  else if (tags.includes("hollow"))
    glyph.setv({ line_color: colour, fill_color: ink("page"), fill_alpha: tag === "event" ? 0 : 1 });
  else glyph.line_color = colour;
};
const paint = () => {
  for (const root of doc.roots()) {
    if (root.title) root.title.text_color = ink("ink");
    for (const side of ["above", "below", "left", "right"])
      for (const each of root[side]) if (each.axis_label_text_color !== undefined) paintAxis(each);
    for (const each of root.center) {
      if (each.grid_line_color !== undefined) each.grid_line_color = ink("grid");
      if (each.tags.includes("rule")) each.line_color = ink("soft");
      if (each.tags.includes("cursor")) each.line_color = ink("ink");
    }
    for (const renderer of root.renderers) {
      const tags = [...renderer.tags, ...renderer.glyph.tags];
      const tag = tags.find((each) => each in INKS);
      if (tag) paintGlyph(renderer.glyph, tag, tags);
    }
  }
};
