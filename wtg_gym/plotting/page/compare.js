// --- A against B: the difference of their scores in every scenario ----------------------------------------------------

// Places of all scenarios and A's gains over B in them, the largest first.
const gains = () => {
  const a = entryOf(state.a), b = entryOf(state.b);
  return a.mean.map((score, i) => ({ i, a: score, b: b.mean[i], gain: score - b.mean[i] }))
    .sort((p, q) => q.gain - p.gain || p.i - q.i);
};
const isTraced = (each) => each.i < suite().scenarios.length;

const fillGains = () => {
  const show = (each) => {
    const seed = String(suite().seeds[each.i]);
    if (!isTraced(each)) return seed;
    const button = make("button", seed, { type: "button" });
    button.setAttribute("aria-label", `Show scenario ${seed}`);
    button.onclick = guarded(() => choose(each.i));
    return button;
  };
  if ($("every").open)
    fillTable($("gains"), ["scenario", "A", "B", "A − B"],
      gains().map((each) => [show(each), each.a.toFixed(1), each.b.toFixed(1), signed(each.gain)]));
};

const fillCompare = () => {
  const a = entryOf(state.a), b = entryOf(state.b);
  const order = gains().map((each, i) => ({ ...each, x: i + 1 })), n = order.length;
  const columns = (own) => ({
    x: own.map((each) => each.x), y: own.map((each) => each.gain),
    seed: own.map((each) => String(suite().seeds[each.i])),
    scores: own.map((each) => `${each.a.toFixed(1)}, ${each.b.toFixed(1)}`),
  });
  sources["gains-a"].data = columns(order.filter((each) => each.gain > 0));
  sources["gains-b"].data = columns(order.filter((each) => each.gain < 0));
  sources["gains-traced"].data = columns(order.filter(isTraced));
  sources["gains-shown"].data = columns(order.filter((each) => isTraced(each) && each.i === state.scenario));
  chart.compare.x_range.setv({ start: 0, end: n + 1 });
  chart.compare.y_range.setv(around([0, ...order.map((each) => each.gain)], 0.08));

  const better = order.filter((each) => each.gain > 0).length, worse = order.filter((each) => each.gain < 0).length;
  // The upper end is minus the lower one of B against A.
  const low = suite().lower[a.place][b.place], high = -suite().lower[b.place][a.place];
  $("verdict").textContent = a === b ? "A and B are the same entry." :
    `A is better in ${better} of ${n} scenarios, worse in ${worse}. Mean of A − B: ${signed(a.score[0] - b.score[0])}, ` +
    `95 % interval of the paired difference ${signed(low)} … ${signed(high)}.`;
  $("compare").setAttribute("aria-label", `Differences of the scores of A, ${a.name}, and B, ${b.name}, in ${n} scenarios, ` +
    `from ${signed(order[0].gain)} to ${signed(order[n - 1].gain)}. The table below holds the numbers.`);
  fillGains();
};

const pickNearest = (x) => {
  const traced = gains().map((each, i) => ({ ...each, x: i + 1 })).filter(isTraced);
  if (!traced.length) return undefined;
  return choose(traced.reduce((best, each) => (Math.abs(each.x - x) < Math.abs(best.x - x) ? each : best)).i);
};
