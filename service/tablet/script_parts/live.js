// The running test: a stream of events, drawn as it comes in, taken up again where it was cut.
const SILENT_MS = 20000;
const READ_MS = 250;  // figures that change more often cannot be read, and each change lays the page out again

if ($("live")) {
  const place = $("live"), view = JSON.parse(place.dataset.liveView), canvas = $("trace"), pen = canvas.getContext("2d");
  const PHASES = {
    queued: t("Waiting for its turn"), checking: t("Looking at the device"), "handing over": t("Taking the valve over"),
    ramping: t("Going to the start"), playing: t("Moving"), returning: t("Going to its safe value"),
    "at its safe value": t("Signal at its safe value"),
    uploading: t("Signal at its safe value. Fetching the device's samples"), ended: t("Motion has ended"), analyzing: t("Analysing"),
  };
  const INK = "#1b1f23", SOFT = "#5d666f", PALE = "#aeb6bd", GRID = "#dde1e4", BLUE = "#005a94";
  const length = view.units.length, pressure = view.units.pressure;
  const decimals = (unit) => (unit.name === "mm" || unit.name === "kPa" ? 1 : 2);
  const shown = (value, unit) => (value === null || value === undefined ? t("no value") : `${(value / unit.in_si).toFixed(decimals(unit))} ${unit.name}`);
  const write = (id, words) => { if ($(id).textContent !== words) $(id).textContent = words; };
  const points = [];
  let done = $("progress").value, drawn = 0, isDirty = true, isNew = false, box = null, lastId = 0, phase = "", lastTextMs = -READ_MS, hasEnded = false;

  function layout() {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    box = { left: 64, right: width - 64, top: 26, bottom: height - 30 };
    frame();
    drawn = 0;
  }
  const [lowPa, highPa] = view.pressure_pa, margin = 0.04;
  const x = (time) => box.left + (box.right - box.left) * Math.min(1, Math.max(0, time / view.duration_s));
  const up = (share) => box.bottom - (box.bottom - box.top) * (margin + (1 - 2 * margin) * Math.min(1.03, Math.max(-0.03, share)));
  const yPosition = (value) => up(value / view.travel_m);
  const yPressure = (value) => up((value - lowPa) / (highPa - lowPa));

  function frame() {
    pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    pen.font = "14px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.setLineDash([]);
    for (const share of [0, 0.25, 0.5, 0.75, 1]) {
      pen.strokeStyle = GRID;
      pen.beginPath(); pen.moveTo(box.left, up(share)); pen.lineTo(box.right, up(share)); pen.stroke();
      pen.fillStyle = BLUE; pen.textAlign = "right";
      pen.fillText((share * view.travel_m / length.in_si).toFixed(decimals(length)), box.left - 8, up(share) + 5);
      pen.fillStyle = SOFT; pen.textAlign = "left";
      pen.fillText(((lowPa + share * (highPa - lowPa)) / pressure.in_si).toFixed(decimals(pressure)), box.right + 8, up(share) + 5);
    }
    pen.fillStyle = BLUE; pen.textAlign = "left"; pen.fillText(`position, ${length.name}`, 4, 15);
    pen.fillStyle = SOFT; pen.textAlign = "right"; pen.fillText(`pressure, ${pressure.name}`, canvas.clientWidth - 4, 15);
    pen.fillStyle = INK;
    for (let part = 0; part <= 4; part += 1) {
      pen.textAlign = part === 0 ? "left" : part === 4 ? "right" : "center";
      pen.fillText(`${Math.round(part * view.duration_s / 4)} s`, x(part * view.duration_s / 4), canvas.clientHeight - 8);
    }
    if (view.plan) {
      pen.strokeStyle = PALE; pen.lineWidth = 1.5; pen.setLineDash([5, 4]); pen.beginPath();
      view.plan.time_s.forEach((time, place) => {
        const height = yPressure(view.plan.pressure_pa[place]);
        if (place) pen.lineTo(x(time), height); else pen.moveTo(x(time), height);
      });
      pen.stroke(); pen.setLineDash([]);
    }
  }

  function line(of, height, colour, width) {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.lineJoin = pen.lineCap = "round"; pen.beginPath();
    let isDown = false;
    for (let place = Math.max(0, drawn - 1); place < points.length; place += 1) {
      const point = points[place], value = point[of];
      if (value === null || point[0] < 0) { isDown = false; continue; }  // a gap stays a gap
      if (isDown) pen.lineTo(x(point[0]), height(value)); else pen.moveTo(x(point[0]), height(value));
      isDown = true;
    }
    pen.stroke();
  }

  function draw() {
    if (isDirty && box) {
      isDirty = false;
      line(2, yPressure, SOFT, 1.5);
      line(1, yPosition, BLUE, 3);
      drawn = points.length;
    }
    const now = performance.now();
    if (isNew && now - lastTextMs >= READ_MS) {
      isNew = false;
      lastTextMs = now;
      tell(points.at(-1));
    }
    requestAnimationFrame(draw);
  }

  function tell(last) {
    $("progress").value = done;
    write("percent", `${Math.round(100 * done)} %`);
    if (!last) return;
    write("position", shown(last[1], length));
    write("pressure", shown(last[2], pressure));
    write("command", shown(last[3], pressure));
    if (phase === "playing") write("left", span(view.duration_s - last[0]));
  }

  const HANDLERS = {
    samples(data) {
      data.time_s.forEach((time, place) => points.push([time, data.position_m[place], data.pressure_pa[place], data.command_pa[place]]));
      isDirty = isNew = true;
    },
    estimate: showEstimate,
    notice: showNotice,
    progress(data) {
      done = data.progress;
      isNew = true;
      if (data.phase !== phase) {
        phase = data.phase;
        const words = PHASES[phase] ?? t("Analysing: {phase}", { phase });
        $("phase").textContent = words;
        say(words);
        if (phase !== "playing") $("left").textContent = phase === "ramping" || phase === "checking" ? span(view.duration_s) : "≈ 1\u00a0min";
      }
    },
    state(data) {
      if (data.state === "analyzing" && $("stop") && !$("stop").dataset.pressed) $("stop-words").textContent = t("The motion has ended.");
      if (data.state === "analyzing") showMeasured();
      if (data.state === "queued" || data.state === "analyzing") HANDLERS.progress({ progress: data.progress, phase: data.state });
    },
    stands(data) {  // the page has it in the units that are shown
      say(data.sentence);
      refresh();
    },
    end(data) {
      hasEnded = true;
      $("phase").textContent = t("The test has ended: {state}", { state: t(data.state) });
      say(t("The test has ended: {state}. The result follows.", { state: t(data.state) }));
      if (!isLocked) showResult();
    },
  };

  // What the motion shows is there long before the diagnosis.
  async function showMeasured() {
    if (!$("early")?.hidden) return;
    try {
      const answer = await ask("GET", `/ui/figures/tests/${place.dataset.test}/measured`, { limitMs: 60000 });
      const fresh = answer.ok ? new DOMParser().parseFromString(answer.text, "text/html").getElementById("early") : null;
      if (!fresh || hasEnded || !$("early")?.hidden) return;
      $("early").replaceWith(fresh);
      say(t("Friction, dead band and signature are shown. The diagnosis follows."));
    } catch { /* the result has them too */ }
  }

  async function showResult() {  // a line that is just lost must not replace the page by the browser's own
    for (;;) {
      try { if ((await ask("GET", location.href)).ok) { location.reload(); return; } } catch { /* later */ }
      await wait(1000);
    }
  }

  function take(block) {
    const fields = {};
    for (const row of block.split("\n")) {
      const cut = row.indexOf(": ");
      if (cut > 0) fields[row.slice(0, cut)] = row.slice(cut + 2);
    }
    if (!fields.event || Number(fields.id) <= lastId) return;
    lastId = Number(fields.id);
    HANDLERS[fields.event]?.(JSON.parse(fields.data));
    place.dataset.points = points.length;
  }

  // A stream by fetch: unlike EventSource it shows the status, the silence, and takes up where it was cut.
  async function follow() {
    while (!hasEnded) {
      const cut = new AbortController();
      let lastHeard = Date.now();
      const watch = setInterval(() => { if (!online || Date.now() - lastHeard > SILENT_MS) cut.abort(); }, 500);
      try {
        const answer = await fetch(`/tests/${place.dataset.test}/events`, {
          headers: { Accept: "text/event-stream", "Last-Event-ID": String(lastId) }, signal: cut.signal, cache: "no-store",
        });
        if (answer.status === 401) lock();
        if (answer.ok) {
          trouble("");
          const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
          let text = "";
          for (;;) {
            const { value, done } = await reader.read();
            if (done) break;
            lastHeard = Date.now();
            text += value;
            const blocks = text.split("\n\n");
            text = blocks.pop();
            blocks.forEach(take);
          }
        }
      } catch { /* cut: taken up again below */ } finally { clearInterval(watch); }
      if (!hasEnded) await wait(1000);
    }
  }

  new ResizeObserver(() => { layout(); isDirty = true; }).observe(canvas);
  layout();
  draw();
  follow();
}
