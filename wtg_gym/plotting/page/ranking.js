// --- ranking: chart, profile, physical metrics, and the table ---------------------------------------------------------

// Rows of the chart, besides those of A and B.
const MOST_ROWS = 25;

const shown = () =>
  suite().entries.filter((entry) =>
    state.kinds.includes(entry.kind) && (!state.action || entry.action === state.action) &&
    entry.name.toLowerCase().includes(state.find.toLowerCase()));

const colours = () => ({ a: ink("a"), b: ink("b"), rest: ink("soft") });
const around = (values, margin) => {
  const least = Math.min(...values), most = Math.max(...values);
  const span = most - least || 1;
  return { start: least - margin * span, end: most + margin * span };
};

const drawRanking = (all) => {
  const entries = all.filter((entry, i) => i < MOST_ROWS || tone(entry.name) !== "rest"), n = entries.length;
  const paints = colours();
  const y = (entry) => n - 1 - entries.indexOf(entry);
  const interval = (e) => `${e.score[0].toFixed(1)} (${e.score[1].toFixed(1)} … ${e.score[2].toFixed(1)})`;
  chart.ranking.setv({ height: (innerWidth < 600 ? 96 : 60) + 24 * Math.max(n, 3) });
  chart.ranking.y_range.setv({ start: -0.7, end: n - 0.3 });
  chart.ranking.x_range.setv(around([0, 100, ...entries.flatMap((entry) => entry.score)], 0.05));
  sources.intervals.data = {
    y: entries.map(y), low: entries.map((e) => e.score[1]), high: entries.map((e) => e.score[2]),
    colour: entries.map((e) => paints[tone(e.name)]),
  };
  for (const kind of ["law", "feedback", "learned"]) {
    const own = entries.filter((entry) => entry.kind === kind);
    sources[`dots-${kind}`].data = {
      x: own.map((e) => e.score[0]), y: own.map(y), name: own.map((e) => plain(e.name)),
      colour: own.map((e) => paints[tone(e.name)]), interval: own.map(interval),
    };
  }
  // On a phone the scale takes lines of its own.
  const scale = ["score", `0 is ${suite().zero}`, `100 is ${suite().hundred}`], narrow = innerWidth < 600;
  chart.ranking.below[0].axis_label = narrow ? scale.join("\n") : `${scale[0]}: ${scale[1]}, ${scale[2]}`;
  const mark = { a: "A  ", b: "B  ", rest: "" };
  const label = (entry) => mark[tone(entry.name)] + plain(short(entry.name, innerWidth < 600 ? 22 : 30));
  const axis = chart.ranking.left[0];
  axis.ticker.ticks = entries.map(y);
  axis.major_label_overrides = new Map(entries.map((entry) => [y(entry), label(entry)]));
  $("ranking").setAttribute("aria-label", `Dot and interval chart of the scores; lines mark 0, ${suite().zero}, and 100, ${suite().hundred}. ` +
    (n ? `From ${entries[0].name}, ${interval(entries[0])}, to ${entries[n - 1].name}, ${interval(entries[n - 1])}. ` : "") +
    "The table below holds the numbers.");
  $("cut").textContent = all.length > n ? `The first ${MOST_ROWS} of ${all.length} entries, and A and B; the table holds all.` : "";
};

const LOWEST = -50, STEP = 0.5;
const sortedScores = (entry) => (entry.sorted ??= Float64Array.from(entry.runs.flatMap((run) => [...run])).sort());
// Shares of the scores above LOWEST, LOWEST + STEP, …
const profile = (entry, n) => {
  const sorted = sortedScores(entry);
  let below = 0;
  return Array.from({ length: n }, (_, i) => {
    while (below < sorted.length && sorted[below] <= LOWEST + STEP * i) below++;
    return 1 - below / sorted.length;
  });
};

const drawProfile = (groups, entries) => {
  const top = Math.max(100, ...entries.map((entry) => sortedScores(entry).at(-1)));
  const n = Math.ceil((top - LOWEST) / STEP) + 3;
  for (const [tag, own] of Object.entries(groups))
    sources[`profile-${tag}`].data = {
      xs: own.map(() => Array.from({ length: n }, (_, i) => LOWEST + STEP * i)),
      ys: own.map((entry) => profile(entry, n)), name: own.map((entry) => plain(entry.name)),
    };
  chart.profile.x_range.setv({ start: LOWEST, end: LOWEST + STEP * n });
  const parts = [5, 25, 50, 75, 95];
  const at = (sorted, percent) => sorted[Math.round(((sorted.length - 1) * percent) / 100)].toFixed(1);
  fillTable($("quantiles"), ["score at the percentile", ...parts.map((percent) => `${percent} %`)],
    entries.map((entry) => [entry.name, ...parts.map((percent) => at(sortedScores(entry), percent))]));
  $("profile").setAttribute("aria-label",
    `Performance profiles of ${entries.length} entries; the table under them holds percentiles of the scores.`);
};

// A run that fails pays for the frequency only until it ends: an entry that fails too often is no part of the front.
const metric = (name) => data.metrics.findIndex((each) => each.name === name);
const ENERGY = metric("mean_energy_share_percent"), FAILURES = metric("failures_percent");
const place = (entry) => ({
  entry, x: entry.physical[ENERGY], y: entry.points.frequency_rocof,
  holds: entry.physical[FAILURES] <= data.most_failures,
});
const beats = (q, p) => q.x >= p.x && q.y >= p.y && (q.x > p.x || q.y > p.y);
const front = (places) => {
  const own = places.filter((each) => each.holds);
  return own.filter((p) => !own.some((q) => beats(q, p))).sort((p, q) => p.x - q.x);
};
const drawFront = (entries) => {
  const paints = colours(), places = entries.map(place), best = front(places);
  const columns = (own) => ({ x: own.map((each) => each.x), y: own.map((each) => each.y) });
  sources["front-line"].data = columns(best);
  for (const kind of ["law", "feedback", "learned"]) {
    const own = places.filter((each) => each.entry.kind === kind);
    sources[`front-${kind}`].data = {
      ...columns(own), name: own.map((each) => plain(each.entry.name)),
      colour: own.map((each) => paints[tone(each.entry.name)]), fill: own.map((each) => (each.holds ? 1 : 0)),
      values: own.map((each) => `${signed(each.y)}, ${each.x.toFixed(2)} %`),
    };
  }
  const x = around(places.length ? places.map((each) => each.x) : [0, 100], 0.06);
  const y = around([0, ...places.map((each) => each.y)], 0.08);
  const chosen = (each) => tone(each.entry.name) !== "rest";
  // Of names that would lie on each other, the chosen entry's or the better one's stands there.
  const meet = (p, q) => Math.abs(p.x - q.x) < 0.2 * (x.end - x.start) && Math.abs(p.y - q.y) < 0.06 * (y.end - y.start);
  const named = places.filter((each) => best.includes(each) || chosen(each)).sort((p, q) => chosen(q) - chosen(p))
    .reduce((kept, each) => (kept.some((other) => meet(other, each)) ? kept : [...kept, each]), []);
  // Names at the right end stand left of their dots.
  const left = named.map((each) => each.x > (x.start + x.end) / 2);
  sources["front-names"].data = {
    ...columns(named), text: named.map((each) => plain(short(each.entry.name, 24))),
    align: left.map((is) => (is ? "right" : "left")), dx: left.map((is) => (is ? -9 : 9)),
  };
  chart.front.x_range.setv(x);
  chart.front.y_range.setv(y);
  $("front").setAttribute("aria-label", `Points of frequency and RoCoF against captured energy, ${entries.length} entries. ` +
    `None beats in both: ${best.map((each) => each.entry.name).join(", ")}. The ranking's table holds the same numbers.`);
};

const drawPhysical = (groups, entries) => {
  const bounds = data.metrics.map((metric, i) => {
    const values = entries.map((entry) => entry.physical[i]);
    const least = Math.min(...values), most = Math.max(...values);
    return metric.up ? { worst: least, best: most } : { worst: most, best: least };
  });
  const height = (value, { worst, best }) => (best === worst ? 1 : (value - worst) / (best - worst));
  for (const [tag, own] of Object.entries(groups))
    sources[`physical-${tag}`].data = {
      xs: own.map((entry) => entry.physical.map((_, i) => i)),
      ys: own.map((entry) => entry.physical.map((value, i) => height(value, bounds[i]))),
      name: own.map((entry) => plain(entry.name)),
    };
  const digits = (value) => // The nominal frequency is what small differences count from.
    entries.length ? Number(value.toPrecision(value > 40 && value < 60 ? 5 : 3)).toString() : "";
  sources.axes.data = {
    x: data.metrics.map((_, i) => i), best: bounds.map((each) => digits(each.best)),
    worst: bounds.map((each) => digits(each.worst)),
  };
};

// --- the table ---

const tables = [...document.querySelectorAll("table[data-suite]")];
const heads = () => [...tables[state.suite].tHead.rows[0].cells];
const isNumber = (head) => head.classList.contains("number");

const sortTable = () => {
  const table = tables[state.suite];
  const column = heads().findIndex((head) => head.textContent === state.sort?.column);
  heads().forEach((head, i) => {
    if (i === column) head.setAttribute("aria-sort", state.sort.down ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  });
  const place = new Map(suite().entries.map((entry, i) => [entry.name, i]));
  const rows = [...table.tBodies[0].rows].sort((p, q) => place.get(p.dataset.name) - place.get(q.dataset.name));
  if (column >= 0) {
    const sign = state.sort.down ? -1 : 1;
    const text = (row) => row.cells[column].textContent;
    if (!isNumber(heads()[column])) rows.sort((p, q) => sign * text(p).localeCompare(text(q), "en", { numeric: true }));
    // What is missing comes last in either order.
    else rows.sort((p, q) => {
      const [x, y] = [parseFloat(text(p)), parseFloat(text(q))];
      return Number.isNaN(x) || Number.isNaN(y) ? Number.isNaN(x) - Number.isNaN(y) : sign * (x - y);
    });
  }
  table.tBodies[0].append(...rows);
};
// Numbers begin with the largest, all but the rank; texts with the first letter; once more turns the order round.
const sortBy = (head) => {
  const column = head.textContent;
  const down = state.sort?.column === column ? !state.sort.down : isNumber(head) && column !== "rank";
  state.sort = { column, down };
  sortTable();
};
const addSortButtons = () => {
  for (const head of tables.flatMap((table) => [...table.tHead.rows[0].cells])) {
    const button = make("button", undefined, { type: "button" });
    button.append(...head.childNodes);
    button.onclick = guarded(() => { sortBy(head); remember(); });
    head.replaceChildren(button);
  }
};

const fillRanking = () => {
  const entries = shown(), n = entries.length;
  const groups = { a: [], b: [], rest: [] };
  for (const entry of entries) groups[tone(entry.name)].push(entry);
  drawRanking(entries);
  drawProfile(groups, entries);
  drawFront(entries);
  drawPhysical(groups, entries);
  const names = new Set(entries.map((entry) => entry.name));
  tables.forEach((table, i) => { table.hidden = i !== state.suite; });
  for (const row of tables[state.suite].tBodies[0].rows) {
    row.hidden = !names.has(row.dataset.name);
    row.className = tone(row.dataset.name);
  }
  for (const each of document.querySelectorAll("[data-environment]")) {
    each.hidden = each.dataset.environment !== suite().environment;
    for (const row of each.querySelector("table").tBodies[0].rows) {
      row.hidden = Boolean(entryOf(row.dataset.name)) && !names.has(row.dataset.name);
      row.className = tone(row.dataset.name);
    }
  }
  sortTable();
  $("shown").textContent = `${n} of ${suite().entries.length} entries shown.`;
};

const described = () =>
  shown().map((entry) => ({
    rank: entry.rank, name: entry.name, kind: entry.kind, action: entry.action, n_runs: entry.n_runs,
    score: entry.score[0], score_low: entry.score[1], score_high: entry.score[2],
    difference_to_above: entry.above?.[0] ?? null, difference_to_above_low: entry.above?.[1] ?? null,
    difference_to_above_high: entry.above?.[2] ?? null,
    ...Object.fromEntries(Object.entries(entry.points).map(([term, points]) => [`points_${term}`, points])),
    iqm: entry.iqm[0],
    probability_of_improvement: entry.improvement[0], gap_closed_percent: entry.gap?.[0] ?? null,
    ...Object.fromEntries(data.metrics.map((metric, i) => [metric.name, entry.physical[i]])), sha256: entry.sha256,
  }));
offer("csv", () => `wtg_gym-${suite().name}.csv`, "text/csv", () => {
  const rows = described();
  return csv([Object.keys(rows[0] ?? { name: "" }), ...rows.map(Object.values)]);
});
offer("json", () => `wtg_gym-${suite().name}.json`, "application/json", () =>
  JSON.stringify({ suite: suite().name, split: suite().split, suite_hash: suite().hash, entries: described() }, null, 1));
