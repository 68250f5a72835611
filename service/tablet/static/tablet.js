// The tablet's script: keeps the page fresh, says when the line is lost, starts, watches and stops a test.
"use strict";
(() => {
const PING_MS = 3000, PING_LIMIT_MS = 2500, REFRESH_MS = 10000, ARMED_MS = 20000, SILENT_MS = 20000;
const $ = (id) => document.getElementById(id);
const page = document.body.dataset.page;
const csrf = document.body.dataset.csrf;
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const clock = (ms) => new Date(ms).toLocaleTimeString([], { hour12: false });

function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

function span(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return whole < 60 ? `${whole}\u00a0s` : `${Math.floor(whole / 60)}\u00a0min ${whole % 60}\u00a0s`;
}

// ---- requests ------------------------------------------------------------------------------------------------
async function ask(method, address, { body, headers = {}, limitMs = 10000 } = {}) {
  const sent = { ...headers };
  if (csrf && method !== "GET") sent["X-CSRF-Token"] = csrf;
  if (body !== undefined) sent["Content-Type"] = "application/json";
  const answer = await fetch(address, {
    method, headers: sent, body: body === undefined ? undefined : JSON.stringify(body),
    cache: "no-store", credentials: "same-origin", signal: AbortSignal.timeout(limitMs),
  });
  const text = await answer.text();
  let found = null;
  try { found = JSON.parse(text); } catch { /* a page, or nothing */ }
  return { ok: answer.ok, status: answer.status, address: answer.url, text, found };
}

const signIn = () => `/ui/sign-in?next=${encodeURIComponent(location.pathname)}`;

function trouble(words, isSignedOut = false) {
  const said = $("trouble-words");
  if (said.firstChild?.data === words) return;
  said.textContent = words;
  if (isSignedOut) {
    const link = element("a", "Sign in");
    link.href = signIn();
    said.append(" ", link);
  }
  $("trouble").hidden = !words;
}

function say(words) { $("said").textContent = words; }

function refusal(answer) {
  if (answer.status === 401) { trouble("You are signed out. A running test goes on.", true); return "You are signed out."; }
  return answer.found?.detail ?? `The gateway answered ${answer.status}: try again.`;
}

// ---- the line to the gateway: what is known, how old it is, and what may be pressed --------------------------
let online = true, knownAt = Date.now();
const guards = [];

function guard() {
  for (const button of document.querySelectorAll("[data-needs-line]")) button.disabled = !online;
  for (const check of guards) check();
}

function heard() {
  knownAt = Date.now();
  if (online) return;
  online = true;
  $("lost").hidden = true;
  say("The connection is back.");
  guard();
  refresh();
}

function lost() {
  if (online) {
    online = false;
    say("The connection is lost.");
    guard();
  }
  const age = span((Date.now() - knownAt) / 1000);
  const live = page === "running" ? " The test goes on without this tablet." : "";
  $("lost-words").textContent =
    `No connection to the gateway. This is what was known at ${clock(knownAt)}, ${age} ago.${live}`;
  $("lost").hidden = false;
}

async function ping() {
  try {
    const answer = await ask("GET", "/healthz", { limitMs: PING_LIMIT_MS, headers: { "X-Background": "1" } });
    if (answer.ok) heard(); else lost();
  } catch { lost(); }
}

async function keepLooking() {
  for (;;) { await ping(); await wait(online ? PING_MS : 1000); }
}

document.addEventListener("click", (event) => {
  if (online || !event.target.closest("a[href]")) return;
  event.preventDefault();
  trouble("There is no connection: this page stays as it is until it is back.");
});

// ---- what changes on a page without a test: fetched again, and replaced where it differs ---------------------
async function refresh() {
  if (document.hidden || !online || !document.querySelector("[data-live]")) return;
  let answer;
  try { answer = await ask("GET", location.href, { headers: { "X-Background": "1" } }); } catch { return; }
  if (new URL(answer.address).pathname === "/ui/sign-in") { trouble("You are signed out. What you see is no longer renewed.", true); return; }
  if (!answer.ok) return;
  const fresh = new DOMParser().parseFromString(answer.text, "text/html");
  if (Boolean(fresh.getElementById("stop")) !== Boolean($("stop"))) { location.reload(); return; }
  for (const old of document.querySelectorAll("[data-live]")) {
    const renewed = fresh.getElementById(old.id);
    if (renewed && renewed.outerHTML !== old.outerHTML && !old.contains(document.activeElement)) old.replaceWith(renewed);
  }
}

// ---- every page ----------------------------------------------------------------------------------------------
$("units")?.addEventListener("change", (event) => {
  document.cookie = `breakaway-units=${event.target.value}; path=/; max-age=31536000; samesite=strict`;
  const address = new URL(location.href);
  address.searchParams.delete("units");
  location.replace(address);
});

$("sign-out")?.addEventListener("click", async () => {
  try { await ask("DELETE", "/session"); location.assign("/ui/sign-in"); } catch { lost(); }
});

$("sign-in")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", "/session", { body: { name: form.elements.name.value, password: form.elements.password.value } });
    if (answer.ok) { location.replace(form.dataset.next); return; }
    $("sign-in-words").textContent = answer.found?.detail ?? `The gateway answered ${answer.status}: try again.`;
  } catch { $("sign-in-words").textContent = "No connection to the gateway: try again."; }
});

$("acknowledge")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", `/tests/${form.dataset.test}/acknowledge`, { body: { note: form.elements.note.value } });
    if (answer.ok) location.reload(); else trouble(refusal(answer));
  } catch { lost(); }
});

$("accept")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", `/valves/${encodeURIComponent(form.dataset.valve)}/model`, { body: { test: form.dataset.test } });
    $("accept-words").textContent = answer.ok ? "Accepted: it is how this valve is from now on." : refusal(answer);
  } catch { lost(); }
});

// ---- permissives ---------------------------------------------------------------------------------------------
const CALLED = { owner: "another master", output: "signal to the I/P", disk: "room on the disk" };
let mayStart = null;

function permissive(one) {
  const [sign, words] = one.met === true ? ["✓", "met"] : one.met === false ? ["✗", "MISSING"] : ["?", "not known"];
  const item = element("li", "", one.met === true ? "met" : one.met === false ? "missing" : "unknown");
  item.append(element("span", sign, "sign"));
  item.lastChild.setAttribute("aria-hidden", "true");
  const said = element("div"), name = CALLED[one.name] ?? one.name.replaceAll("_", " ");
  if (one.met === true) {
    said.append(element("strong", name), element("span", " met: ", "unseen"), element("span", ` ${one.value}`, "aside"));
  } else {
    said.append(element("strong", name), element("span", `: ${words}`));
    said.append(element("div", [one.value, one.limit && `needed: ${one.limit}`].filter(Boolean).join("; "), "aside"));
    if (one.name === "last_test" && one.met === false) {
      const isHere = Boolean($("acknowledge"));
      const link = element("a", `Look at the valve, then say so ${isHere ? "above" : "on its page"}`, "remedy");
      link.href = isHere ? "#h-ack" : `/ui/valves/${encodeURIComponent($("permissives").dataset.valve)}`;
      said.append(link);
    } else if (one.name === "permit" && one.met === false) {
      said.append(element("div", $("permit") ? "Enter the work permit's number" : "Its number is asked for where a test is started", "remedy"));
    } else if (one.remedy) said.append(element("div", one.remedy, "remedy"));
  }
  item.append(said);
  return item;
}

async function lookAtPermissives() {
  const place = $("permissives"), wanted = new URLSearchParams({ units: $("units").value });
  if ($("permit")?.value) wanted.set("permit", $("permit").value);
  let answer;
  try {
    answer = await ask("GET", `/valves/${encodeURIComponent(place.dataset.valve)}/permissives?${wanted}`, { limitMs: 15000 });
  } catch {
    mayStart = null;
    place.replaceChildren(element("p", "The gateway did not answer: look again."));
    guard();
    return;
  }
  if (!answer.ok) {
    mayStart = null;
    place.replaceChildren(element("p", refusal(answer), "sum missing"));
  } else {
    mayStart = answer.found.may_start;
    const list = element("ul", "", "permissives");
    const rank = (one) => (one.met === false ? 0 : one.met === null ? 1 : 2);
    for (const one of [...answer.found.permissives].sort((a, b) => rank(a) - rank(b))) list.append(permissive(one));
    const sum = element("p", mayStart ? "Yes, all is there." : "No, see what is missing:", mayStart ? "sum" : "sum missing");
    const readAt = Date.parse(answer.found.read_at) || Date.now(), isOld = Date.now() - readAt > 15000;
    const age = `${isOld ? "Last known, read" : "Read"} from the device at ${clock(readAt)}`;
    place.replaceChildren(sum, list, element("p", age, "aside"));
  }
  guard();
}

if ($("permissives")) {
  $("look-again").addEventListener("click", lookAtPermissives);
  let typed = 0;
  $("permit")?.addEventListener("input", () => { clearTimeout(typed); typed = setTimeout(lookAtPermissives, 600); });
  lookAtPermissives();
}

// ---- starting: two deliberate steps --------------------------------------------------------------------------
if ($("start")) {
  const form = $("start"), arm = $("arm"), go = $("go"), words = $("armed-words");
  let armedUntil = 0, isStarting = false;

  const disarm = (why) => { armedUntil = 0; words.textContent = why; guard(); };
  guards.push(() => {
    if (!online) armedUntil = 0;
    arm.disabled = !online || mayStart !== true || isStarting;
    go.disabled = !online || mayStart !== true || isStarting || Date.now() > armedUntil;
  });
  const summarize = () => {
    const chosen = form.querySelector("[name=sequence]:checked");
    $("summary").textContent = chosen ? `${form.dataset.valve} moves over its travel: ${chosen.dataset.words}.` : "No sequence is possible.";
  };
  summarize();
  form.addEventListener("input", () => { summarize(); disarm("Something was changed. Step 2 is locked."); });
  arm.addEventListener("click", async () => {
    words.textContent = "Asking the device once more…";
    await lookAtPermissives();
    if (mayStart !== true) { disarm("Step 2 is locked: see what is missing."); return; }
    armedUntil = Date.now() + ARMED_MS;
    guard();
  });
  setInterval(() => {
    if (!armedUntil || isStarting) return;
    const left = armedUntil - Date.now();
    if (left <= 0) disarm("That took too long. Step 2 is locked again.");
    else words.textContent = `Step 2 is open for ${Math.ceil(left / 1000)} s.`;
  }, 250);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (go.disabled) return;
    isStarting = true;
    guard();
    words.textContent = "Starting…";
    const key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (one) => one.toString(16).padStart(2, "0")).join("");
    const fields = new FormData(form), body = { valve: form.dataset.valve, sequence: fields.get("sequence") };
    for (const name of ["label", "permit"]) if (fields.get(name)) body[name] = fields.get(name);
    for (let attempt = 1; attempt <= 3; attempt += 1) {
      try {
        const answer = await ask("POST", "/tests/run", { body, headers: { "Idempotency-Key": key } });
        if (answer.ok) { location.assign(`/ui/tests/${answer.found.id}`); return; }
        trouble(refusal(answer));
        break;
      } catch {  // the same key: a test that was started already is not started twice
        trouble(attempt < 3 ? "No answer yet: asking again." : "The gateway did not answer: look at the valve's page whether the test runs.");
      }
    }
    isStarting = false;
    disarm("Not started. Step 2 is locked.");
    lookAtPermissives();
  });
}

// ---- stop: one press, sent until it is answered --------------------------------------------------------------
$("stop")?.addEventListener("click", async (event) => {
  const button = event.currentTarget, words = $("stop-words");
  if (button.dataset.pressed) return;
  button.dataset.pressed = "yes";
  button.setAttribute("aria-disabled", "true");
  words.textContent = "Stop is being sent…";
  for (;;) {
    try {
      const answer = await ask("POST", `/tests/${button.dataset.test}/stop`, { limitMs: online ? 10000 : 2000 });
      if (answer.ok) {
        words.textContent = answer.found.safe_confirmed === true ? "Stopped. The valve is at its safe value." : "Stop is received.";
        if (page !== "running") setTimeout(() => location.reload(), 1500);
        return;
      }
      words.textContent = refusal(answer);
      if (answer.status < 500) break;
    } catch {
      words.textContent = "STOP IS NOT SENT: no connection. Trying on. Use the means at the valve itself.";
    }
    await wait(700);
  }
  delete button.dataset.pressed;
  button.removeAttribute("aria-disabled");
});

// ---- the running test ----------------------------------------------------------------------------------------
if ($("live")) {
  const place = $("live"), view = JSON.parse(place.dataset.liveView), canvas = $("trace"), pen = canvas.getContext("2d");
  const PHASES = {
    queued: "Waiting for its turn", checking: "Looking at the device", "handing over": "Taking the valve over",
    ramping: "Going to the start", playing: "Moving", returning: "Going to its safe value",
    uploading: "At its safe value. Fetching the device's samples", ended: "Motion has ended", analyzing: "Analysing",
  };
  const INK = "#1b1f23", SOFT = "#5d666f", PALE = "#aeb6bd", GRID = "#dde1e4", BLUE = "#005a94";
  const length = view.units.length, pressure = view.units.pressure;
  const decimals = (unit) => (unit.name === "mm" || unit.name === "kPa" ? 1 : 2);
  const shown = (value, unit) => (value === null || value === undefined ? "no value" : `${(value / unit.in_si).toFixed(decimals(unit))} ${unit.name}`);
  const points = [];
  let drawn = 0, isDirty = true, isNew = false, box = null, lastId = 0, phase = "", lastTextMs = -1000, hasEnded = false;

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
    const now = performance.now(), last = points.at(-1);
    if (isNew && now - lastTextMs >= 90) {  // ten times a second is what an eye follows
      isNew = false;
      lastTextMs = now;
      $("position").textContent = shown(last[1], length);
      $("pressure").textContent = shown(last[2], pressure);
      $("command").textContent = shown(last[3], pressure);
      if (phase === "playing") $("left").textContent = span(view.duration_s - last[0]);
    }
    requestAnimationFrame(draw);
  }

  const HANDLERS = {
    samples(data) {
      data.time_s.forEach((time, place) => points.push([time, data.position_m[place], data.pressure_pa[place], data.command_pa[place]]));
      isDirty = isNew = points.length > 0;
    },
    progress(data) {
      $("progress").value = data.progress;
      $("percent").textContent = `${Math.round(100 * data.progress)} %`;
      if (data.phase !== phase) {
        phase = data.phase;
        const words = PHASES[phase] ?? `Analysing: ${phase}`;
        $("phase").textContent = words;
        say(words);
        if (phase !== "playing") $("left").textContent = phase === "ramping" || phase === "checking" ? span(view.duration_s) : "≈ 1\u00a0min";
      }
    },
    state(data) {
      if (data.state === "analyzing" && !$("stop").dataset.pressed) $("stop-words").textContent = "The motion has ended. The valve is at its safe value.";
      if (data.state === "queued" || data.state === "analyzing") HANDLERS.progress({ progress: data.progress, phase: data.state });
    },
    end(data) {
      hasEnded = true;
      $("phase").textContent = `The test has ended: ${data.state}`;
      say(`The test has ended: ${data.state}. The result follows.`);
      showResult();
    },
  };

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
        if (answer.status === 401) trouble("You are signed out. The test goes on; sign in to see it and to stop it.", true);
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

guard();
keepLooking();
setInterval(refresh, REFRESH_MS);
})();
