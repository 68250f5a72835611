// What all parts use: the page, its words and times, and requests to the gateway.
const $ = (id) => document.getElementById(id);
const page = document.body.dataset.page;
// A sentence in the language of the page; WORDS has those that are not English.
const t = (sentence, values = {}) => (WORDS[sentence] ?? sentence).replace(/\{(\w+)\}/g, (_, name) => values[name]);
const csrf = document.body.dataset.csrf;
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const LOCALE = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
// By the plant's clock, wherever the tablet was set up; by its own where the plant names no zone.
const dial = (() => {
  const shown = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23", timeZoneName: "short" };
  try { return new Intl.DateTimeFormat(LOCALE, { ...shown, timeZone: document.body.dataset.zone }); } catch { return new Intl.DateTimeFormat(LOCALE, shown); }
})();
const clock = (ms) => dial.format(ms);

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

// Who reads: the gateway says in these units and this language what it says to a page.
const readerHeaders = () => ({ "Breakaway-Units": $("units").value, "Accept-Language": document.documentElement.lang });

async function ask(method, address, { body, headers = {}, limitMs = 10000 } = {}) {
  const sent = { ...readerHeaders(), ...headers };
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
    const link = element("a", t("Sign in"));
    link.href = signIn();
    said.append(" ", link);
  }
  $("trouble").hidden = !words;
}

// Who is signed out sees nothing of the plant any more. Stop stays: it was theirs when the page was opened.
let isLocked = false, isStopLost = false;
function lock() {
  isLocked = true;
  $("main").hidden = true;
  const more = !$("stop") ? "" : isStopLost ? t("A running test goes on.") : t("The test goes on, and STOP still works.");
  trouble(`${t("You are signed out: this page is locked.")} ${more}`, true);
}

function say(words) { $("said").textContent = words; }

function refusal(answer) {
  if (answer.status === 401) { lock(); return t("You are signed out."); }
  return answer.found?.shown ?? answer.found?.detail ?? t("The gateway answered {status}: try again.", { status: answer.status });
}
