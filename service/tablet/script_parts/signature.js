// The signature: other tests laid over it, a cursor with values, and zoom by wheel, pinch and buttons.
const NARROW_PX = 600, MOST_OTHERS = 3, MOST_ZOOM = 60, SVG = "http://www.w3.org/2000/svg";

if ($("signature")) {
  const place = $("signature"), holder = $("signature-figure"), read = $("cursor-words"), slider = $("cursor");
  const chips = [...place.querySelectorAll("[data-with]")], any = $("any-test");
  let panes = [], root = null, hair = null, atTravel = null, asked = 0;
  const numbers = (text) => text.trim().split(/\s+/).map(Number);
  const limited = (value, low, high) => Math.min(high, Math.max(low, value));

  function chosen() {
    const found = chips.filter((chip) => chip.getAttribute("aria-pressed") === "true").map((chip) => chip.dataset.with);
    return any?.value ? [...found, any.value] : found;
  }

  async function draw() {
    const number = asked += 1, isNarrow = matchMedia(`(max-width: ${NARROW_PX}px)`).matches;
    const address = place.dataset.address + chosen().map((one) => `&with=${one}`).join("") + (isNarrow ? "&narrow=1" : "");
    try {
      const answer = await ask("GET", address);
      if (number !== asked) return;
      if (!answer.ok) { trouble(refusal(answer)); return; }
      const made = document.importNode(new DOMParser().parseFromString(answer.text, "image/svg+xml").documentElement, true);
      if (made.localName !== "svg") return;
      made.removeAttribute("width"); made.removeAttribute("height");
      made.classList.add("figure");
      holder.replaceChildren(made);
      begin(made);
    } catch { lost(); }
  }

  // A pane with its scales, as the service wrote them; the zoom is a factor and a shift of what it drew.
  function pane(of) {
    const [left, top, width, height] = numbers(of.dataset.box), x = numbers(of.dataset.x), y = numbers(of.dataset.y);
    const curves = [...of.querySelectorAll(".curve, .band")].map((one) => ({
      of: one.dataset.of, way: one.dataset.way, isBand: one.classList.contains("band"),
      points: numbers(one.getAttribute("points").replaceAll(",", " ")),
    }));
    return { of, left, top, width, height, x, y, curves, unit: of.dataset.unit, right: of.dataset.right ? numbers(of.dataset.right) : null,
      rightUnit: of.dataset.rightUnit, zoom: { sx: 1, sy: 1, tx: 0, ty: 0 }, data: of.querySelector(".data"), ticks: of.querySelector(".ticks"), labels: [] };
  }

  function begin(made) {
    root = made;
    panes = [...made.querySelectorAll(".pane")].map(pane);
    panes.forEach((one, number) => {
      one.labels = [...made.querySelectorAll(`.at.p${number}`)].map((label) => ({ label, x: Number(label.getAttribute("x")), y: Number(label.getAttribute("y")) }));
    });
    hair = document.createElementNS(SVG, "path");
    hair.setAttribute("class", "hair");
    made.append(hair);
    listen(made);
    if (atTravel !== null) tell(atTravel);
  }

  const fromX = (one, px) => one.x[0] + (one.x[1] - one.x[0]) * ((px - one.zoom.tx - one.left) / one.zoom.sx) / one.width;
  const toX = (one, value) => one.left + one.zoom.tx + one.zoom.sx * one.width * (value - one.x[0]) / (one.x[1] - one.x[0]);
  const fromY = (one, px) => one.y[1] - (one.y[1] - one.y[0]) * ((px - one.zoom.ty - one.top) / one.zoom.sy) / one.height;
  const toY = (one, value) => one.top + one.zoom.ty + one.zoom.sy * one.height * (one.y[1] - value) / (one.y[1] - one.y[0]);

  function steps(low, high, most) {
    const raw = (high - low) / most, size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 2.5, 5, 10].map((one) => one * size).find((one) => one >= raw * (1 - 1e-9)), found = [];
    for (let number = Math.ceil(low / step - 1e-9); number * step <= high + 1e-9 * step; number += 1) found.push(Number((number * step).toPrecision(10)));
    return found;
  }

  function scale(one) {
    const { left, top, width, height } = one, end = left + width, foot = top + height, made = [];
    const add = (name, attributes, words = "") => {
      const node = document.createElementNS(SVG, name);
      for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
      node.textContent = words;
      made.push(node);
    };
    for (const value of steps(fromX(one, left), fromX(one, end), width > 450 ? 10 : 5)) {
      const x = toX(one, value);
      add("path", { d: `M${x} ${top}V${foot}`, stroke: "#e3e6e9" });
      add("text", { x, y: foot + 17, "text-anchor": "middle", fill: "#1b1f23" }, String(value));
    }
    for (const value of steps(fromY(one, foot), fromY(one, top), height > 250 ? 10 : 5)) {
      const y = toY(one, value);
      add("path", { d: `M${left} ${y}H${end}`, stroke: "#e3e6e9" });
      add("text", { x: left - 6, y: y + 4.5, "text-anchor": "end", fill: "#1b1f23" }, String(value));
      if (one.right) add("text", { x: end + 6, y: y + 4.5, fill: "#6b737c" }, short(inUnit(one, value), inUnit(one, fromY(one, top)) - inUnit(one, fromY(one, foot))));
    }
    one.ticks.replaceChildren(...made);
  }

  function short(value, span) {
    const digits = Math.max(0, 2 - Math.floor(Math.log10(span)));
    return Math.abs(value) > 0.5 * 10 ** -digits ? value.toFixed(digits) : "0";
  }

  const inUnit = (one, value) => one.right[0] + (one.right[1] - one.right[0]) * (value - one.y[0]) / (one.y[1] - one.y[0]);

  function show() {
    for (const one of panes) {
      const { sx, sy, tx, ty } = one.zoom;
      one.data.setAttribute("transform", `matrix(${sx} 0 0 ${sy} ${one.left * (1 - sx) + tx} ${one.top * (1 - sy) + ty})`);
      for (const { label, x, y } of one.labels) {
        const newX = one.left + tx + sx * (x - one.left), newY = one.top + ty + sy * (y - one.top);
        label.setAttribute("x", newX);
        label.setAttribute("y", newY);
        const isIn = newX >= one.left - 1 && newX <= one.left + one.width + 1 && newY >= one.top - 1 && newY <= one.top + one.height + 1;
        label.setAttribute("visibility", isIn ? "visible" : "hidden");
      }
      scale(one);
    }
    place.dataset.zoom = panes[0].zoom.sx.toFixed(2);
    if (atTravel !== null) tell(atTravel);
  }

  // Both panes share the travel; the pane under the pointer alone is stretched upright.
  function zoom(factor, px, py, under = panes.find((one) => py >= one.top && py <= one.top + one.height) ?? panes[0]) {
    const before = panes[0].zoom.sx, sx = limited(before * factor, 1, MOST_ZOOM);
    for (const one of panes) {
      const at = one.zoom, ratio = sx / at.sx;
      at.tx = limited((px - one.left) * (1 - ratio) + at.tx * ratio, one.width * (1 - sx), 0);
      at.sx = sx;
      if (one === under || sx === 1) {
        const sy = sx === 1 ? 1 : limited(at.sy * factor, 1, MOST_ZOOM), up = sy / at.sy;
        at.ty = limited((py - one.top) * (1 - up) + at.ty * up, one.height * (1 - sy), 0);
        at.sy = sy;
      }
    }
    show();
    return sx !== before;
  }

  function shift(dx, dy, py) {
    for (const one of panes) {
      const at = one.zoom;
      at.tx = limited(at.tx + dx, one.width * (1 - at.sx), 0);
      if (py >= one.top && py <= one.top + one.height) at.ty = limited(at.ty + dy, one.height * (1 - at.sy), 0);
    }
    show();
  }

  // The value of a curve at a travel, by its own points, which run one way; null where it has none.
  function valueAt(points, x) {
    for (let row = 0; row + 3 < points.length; row += 2) {
      const [x0, y0, x1, y1] = points.slice(row, row + 4);
      if ((x0 <= x && x <= x1) || (x1 <= x && x <= x0)) return x0 === x1 ? y0 : y0 + (y1 - y0) * (x - x0) / (x1 - x0);
    }
    return null;
  }

  function tell(travel) {
    atTravel = limited(travel, panes[0].x[0], panes[0].x[1]);
    const shown = limited(toX(panes[0], atTravel), panes[0].left, panes[0].left + panes[0].width);
    hair.setAttribute("d", panes.map((one) => `M${shown} ${one.top}v${one.height}`).join(""));
    slider.value = atTravel;
    const lines = [[t("Travel {percent} %", { percent: atTravel.toFixed(1) })]], found = new Map();
    panes.forEach((one, number) => {
      const x = one.left + one.width * (atTravel - one.x[0]) / (one.x[1] - one.x[0]);
      const value = (y) => one.y[1] - (one.y[1] - one.y[0]) * (y - one.top) / one.height;
      for (const curve of one.curves.filter((each) => !each.isBand)) {
        const y = valueAt(curve.points, x);
        if (y === null) continue;
        const words = number === 0 ? `${value(y).toFixed(1)} % (${inUnit(one, value(y)).toPrecision(4)} ${one.rightUnit})` : t("friction {value} {unit}", { value: value(y).toPrecision(3), unit: one.unit });
        const band = one.curves.find((each) => each.isBand && each.of === curve.of && each.way === curve.way), half = band ? band.points.length / 2 : 0;
        const ends = band ? [band.points.slice(half), band.points.slice(0, half)].map((each) => valueAt(each, x)) : [null];
        const beside = ends.includes(null) ? "" : t(", 95 % band {low} to {high}", { low: value(ends[0]).toPrecision(3), high: value(ends[1]).toPrecision(3) });
        const key = `${curve.of} ${curve.way}`;
        found.set(key, [...(found.get(key) ?? []), words + beside]);
      }
    });
    const isAlone = new Set([...found.keys()].map((key) => key[0])).size < 2;
    for (const key of [...found.keys()].sort()) lines.push([isAlone ? key.slice(2) : key, found.get(key).join(", ")]);
    read.replaceChildren(...lines.map(([name, words]) => element("span", words ? `${name}: ${words}` : name)));
  }

  function listen(made) {
    const down = new Map();
    const spot = (event) => { const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(made.getScreenCTM().inverse()); return [at.x, at.y]; };
    made.addEventListener("wheel", (event) => {  // out of the whole figure the wheel scrolls the page
      if (zoom(event.deltaY < 0 ? 1.25 : 0.8, ...spot(event))) event.preventDefault();
    }, { passive: false });
    made.addEventListener("pointerdown", (event) => { down.set(event.pointerId, spot(event)); tell(fromX(panes[0], spot(event)[0])); });
    for (const name of ["pointerup", "pointercancel", "pointerleave"]) made.addEventListener(name, (event) => down.delete(event.pointerId));
    made.addEventListener("pointermove", (event) => {
      const now = spot(event), was = down.get(event.pointerId);
      if (was && down.size === 2) {
        const other = [...down].find(([id]) => id !== event.pointerId)[1];
        const far = Math.hypot(now[0] - other[0], now[1] - other[1]), near = Math.hypot(was[0] - other[0], was[1] - other[1]);
        if (near > 0) zoom(far / near, (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
        shift((now[0] - was[0]) / 2, (now[1] - was[1]) / 2, now[1]);
      } else if (was && panes[0].zoom.sx > 1 && event.pointerType === "mouse") shift(now[0] - was[0], now[1] - was[1], now[1]);
      else tell(fromX(panes[0], now[0]));
      if (was) down.set(event.pointerId, now);
    });
  }

  const middle = () => [atTravel === null ? panes[0].left + panes[0].width / 2 : limited(toX(panes[0], atTravel), panes[0].left, panes[0].left + panes[0].width), panes[0].top + panes[0].height / 2];
  $("zoom-in").addEventListener("click", () => { if (root) zoom(1.6, ...middle()); });
  $("zoom-out").addEventListener("click", () => { if (root) zoom(0.625, ...middle()); });
  slider.addEventListener("input", () => { if (root) tell(Number(slider.value)); });

  async function against(test) {
    const table = $("compared");
    if (!table || !test) return;
    try {
      const answer = await ask("GET", `/ui/tests/${place.dataset.test}/compared?before=${test}`);
      const fresh = answer.ok ? new DOMParser().parseFromString(answer.text, "text/html").getElementById("compared") : null;
      if (fresh) table.replaceWith(fresh);
    } catch { lost(); }
  }

  for (const chip of chips) chip.addEventListener("click", () => {
    const isOn = chip.getAttribute("aria-pressed") !== "true";
    if (isOn && chosen().length >= MOST_OTHERS) { say(t("Three tests are shown already: take one away first.")); return; }
    chip.setAttribute("aria-pressed", String(isOn));
    draw();
    if (isOn) against(chip.dataset.with);
  });
  any?.addEventListener("change", () => { draw(); against(any.value); });
  matchMedia(`(max-width: ${NARROW_PX}px)`).addEventListener("change", draw);
  $("signature-tools").hidden = false;
  draw();
}
