// Friction of a running test: each estimate so far as a line, the newest in full ink, one strip a quantity.
const STRIP_ROWS = 12, ESTIMATED = { F_c: t("Friction in motion (F_c)"), F_s: t("Friction at breakaway (F_s)") };
const soFar = [];

function showEstimate(data) {
  soFar.push(data);
  const unit = JSON.parse($("so-far").dataset.force), said = [];
  const digits = (value) => Number(value.toPrecision(4)).toString();
  $("so-far-strips").replaceChildren(...Object.entries(ESTIMATED).map(([symbol, name]) => {
    const figure = element("figure"), newest = data.parameters[symbol];
    let words = t("{name}: not known yet", { name });
    if (newest) {
      const [low, high] = newest.ci95.map((end) => digits(end / unit.in_si)), percent = 50 * (newest.ci95[1] - newest.ci95[0]) / Math.abs(newest.value);
      words = `${name}: ${digits(newest.value / unit.in_si)} ${unit.name} (${t("{low} to {high}", { low, high })}), \u00b1${percent.toPrecision(2)}\u00a0%`;
    }
    said.push(words);
    figure.append(element("figcaption", words), strip(soFar.map((one) => one.parameters[symbol]).filter(Boolean).slice(-STRIP_ROWS), words));
    return figure;
  }));
  $("so-far-words").textContent = 
    t("{count} breakaways after {time} s. Lines: 95 % intervals, the newest at the foot.", { count: data.breakaways, time: Math.round(data.time_s) });
  $("so-far").dataset.estimates = soFar.length;
  if (soFar.length % 3 === 1) say(said.join(". "));  // each one would drown what else is said
}

// Lines over one scale, drawn by the quantity's own range: intervals that lie far apart stay visible.
function strip(entries, words) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg"), width = 480, row = 9, height = row * STRIP_ROWS;
  for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, class: "figure", role: "img", "aria-label": words })) made.setAttribute(key, value);
  if (!entries.length) return made;
  const low = Math.min(...entries.map((one) => one.ci95[0])), high = Math.max(...entries.map((one) => one.ci95[1]));
  const x = (value) => 6 + (width - 12) * (high > low ? (value - low) / (high - low) : 0.5);
  entries.forEach((one, place) => {
    const isNewest = place === entries.length - 1, y = row * (place + 0.5), line = document.createElementNS(made.namespaceURI, "path");
    line.setAttribute("d", `M${x(one.ci95[0])} ${y}H${x(one.ci95[1])}M${x(one.value)} ${y - 3}v6`);
    line.setAttribute("stroke", isNewest ? "#005a94" : "#aeb6bd");
    line.setAttribute("stroke-width", isNewest ? 4 : 2);
    made.append(line);
  });
  return made;
}

function showNotice(data) {
  const place = $("notice");
  let words = data.sentence;
  if (data.kind !== "enough") {
    const unit = JSON.parse($("so-far").dataset.force), shown = (force) => `${Number((force / unit.in_si).toPrecision(3))} ${unit.name}`;
    const forces = { force: shown(data.force_n), last: shown(data.last_n) };
    words = data.kind === "breakaway" ? t("The stem sticks: it takes {force}, twice its last breakaway of {last}.", forces)
      : t("The test ends early: the stem takes {force}, twice its last breakaway of {last}.", forces);
  }
  place.classList.toggle("alarm", data.kind !== "enough");
  place.dataset.kind = data.kind;
  place.textContent = words;
  place.hidden = false;
}
