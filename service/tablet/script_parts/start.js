// Starting: two deliberate steps.
const ARMED_MS = 20000;

if ($("start")) {
  const form = $("start"), arm = $("arm"), go = $("go"), words = $("armed-words");
  let armedUntil = 0, isStarting = false;

  const disarm = (why) => { armedUntil = 0; words.textContent = why; guard(); };
  guards.push(() => {
    if (!online) armedUntil = 0;
    arm.disabled = !online || mayStart !== true || isStarting;
    go.disabled = !online || mayStart !== true || isStarting || Date.now() > armedUntil;
    const isTold = Boolean(words.querySelector("a"));
    if (mayStart !== false) { if (isTold) words.textContent = t("Step 2 is locked."); return; }
    if (isTold) return;
    const link = element("a", t("See what is missing"));  // a page that was scrolled
    link.href = "#h-permits";
    words.replaceChildren(`${t("Both steps are locked.")} `, link);
  });
  const wishes = () => [...form.querySelectorAll("#until input")].filter((one) => !one.disabled && one.value.trim());
  const summarize = () => {
    const chosen = form.querySelector("[name=sequence]:checked");
    for (const one of form.querySelectorAll("#until input")) one.disabled = chosen?.value === "separating";  // needs all of it
    const early = wishes().map((one) => t("{what} to ± {percent} %", { what: one.dataset.words, percent: one.value.trim() })).join(t(" and "));
    const what = { valve: form.dataset.valve, words: chosen?.dataset.words, early };
    $("summary").textContent = !chosen ? t("No sequence is possible.")
      : early ? t("{valve} moves over its travel: {words}, or until it knows {early}.", what) : t("{valve} moves over its travel: {words}.", what);
  };
  summarize();
  form.addEventListener("input", () => { summarize(); disarm(t("Something was changed. Step 2 is locked.")); });
  arm.addEventListener("click", async () => {
    words.textContent = t("Asking the device once more…");
    await lookAtPermissives();
    if (mayStart !== true) { disarm(t("Step 2 is locked.")); return; }
    armedUntil = Date.now() + ARMED_MS;
    guard();
  });
  setInterval(() => {
    if (!armedUntil || isStarting) return;
    const left = armedUntil - Date.now();
    if (left <= 0) disarm(t("That took too long. Step 2 is locked again."));
    else words.textContent = t("Step 2 is open for {time} s.", { time: Math.ceil(left / 1000) });
  }, 250);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (go.disabled) return;
    isStarting = true;
    guard();
    words.textContent = t("Starting…");
    const key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (one) => one.toString(16).padStart(2, "0")).join("");
    const fields = new FormData(form), body = { valve: form.dataset.valve, sequence: fields.get("sequence") };
    for (const name of ["label", "permit"]) if (fields.get(name)) body[name] = fields.get(name);
    for (const one of wishes()) (body.until ??= {})[one.dataset.symbol] = `${one.value.trim().replace(",", ".")} %`;
    for (let attempt = 1; attempt <= 3; attempt += 1) {
      try {
        const answer = await ask("POST", "/tests/run", { body, headers: { "Idempotency-Key": key } });
        if (answer.ok) { location.assign(`/ui/tests/${answer.found.id}`); return; }
        trouble(refusal(answer));
        break;
      } catch {  // the same key: a test that was started already is not started twice
        trouble(attempt < 3 ? t("No answer yet: asking again.") : t("The gateway did not answer: look at the valve's page whether the test runs."));
      }
    }
    isStarting = false;
    disarm(t("Not started. Step 2 is locked."));
    lookAtPermissives();
  });
}
