// The line to the gateway: what is known, how old it is, what may be pressed, and a page that keeps fresh.
const PING_MS = 3000, PING_LIMIT_MS = 2500, REFRESH_MS = 10000, MOVING_MS = 2000;
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
  say(t("The connection is back."));
  guard();
  refresh();
}

function lost() {
  if (online) {
    online = false;
    say(t("The connection is lost."));
    guard();
  }
  const age = span((Date.now() - knownAt) / 1000);
  const live = page === "running" ? ` ${t("The test goes on without this tablet.")}` : "";
  $("lost-words").textContent =
    t("No connection to the gateway. This is what was known at {at}, {age} ago.", { at: clock(knownAt), age }) + live;
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
  trouble(t("There is no connection: this page stays as it is until it is back."));
});

// What changes on a page without a test is fetched again, and replaced where it differs.
async function refresh() {
  if (document.hidden || !online || page === "sign-in") return;
  const isRenewed = document.querySelector("[data-live]");
  if (!isRenewed && !csrf) return;
  let answer;
  const asked = location.href;
  try { answer = await ask("GET", isRenewed ? location.href : "/session", { headers: { "X-Background": "1" } }); } catch { return; }
  if (answer.status === 401 || new URL(answer.address).pathname === "/ui/sign-in") { lock(); return; }
  if (!answer.ok) return;
  if (isLocked) { location.reload(); return; }  // somebody signed in on another page of this browser
  if (!isRenewed || location.href !== asked) return;  // another list was asked for meanwhile
  const fresh = new DOMParser().parseFromString(answer.text, "text/html");
  const wasMoving = $("stands")?.dataset.verdict === "moving", isMoving = fresh.getElementById("stands")?.dataset.verdict === "moving";
  if (Boolean(fresh.getElementById("stop")) !== Boolean($("stop")) || (page !== "running" && wasMoving && !isMoving)) { location.reload(); return; }
  renew(fresh);
}

function renew(fresh) {
  for (const old of document.querySelectorAll("[data-live]")) {
    const renewed = fresh.getElementById(old.id);
    for (const one of old.querySelectorAll("details[id]")) renewed?.querySelector(`#${one.id}`)?.toggleAttribute("open", one.open);
    if (renewed && renewed.outerHTML !== old.outerHTML && !old.contains(document.activeElement)) old.replaceWith(renewed);
  }
}
