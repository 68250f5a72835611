// Units, language, signing in and out, acknowledging a test, what is said of it, accepting a model or a baseline, analysing again.
for (const name of ["units", "language"]) $(name)?.addEventListener("change", (event) => {
  document.cookie = `breakaway-${name}=${event.target.value}; path=/; max-age=31536000; samesite=strict`;
  const address = new URL(location.href);
  address.searchParams.delete(name);
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
    $("sign-in-words").textContent = answer.found?.shown ?? answer.found?.detail ?? t("The gateway answered {status}: try again.", { status: answer.status });
  } catch { $("sign-in-words").textContent = t("No connection to the gateway: try again."); }
});

$("acknowledge")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", `/tests/${form.dataset.test}/acknowledge`, { body: { note: form.elements.note.value } });
    if (answer.ok) location.reload(); else trouble(refusal(answer));
  } catch { lost(); }
});

$("describe")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget, said = {};
  for (const name of ["label", "work_order", "note"]) said[name] = form.elements[name].value.trim() || null;
  try {
    const answer = await ask("PATCH", `/tests/${form.dataset.test}`, { body: said });
    if (answer.ok) location.reload(); else trouble(refusal(answer));
  } catch { lost(); }
});

$("accept")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", `/valves/${encodeURIComponent(form.dataset.valve)}/model`, { body: { test: form.dataset.test } });
    $("accept-words").textContent = answer.ok ? t("Accepted: it is how this valve is from now on.") : refusal(answer);
  } catch { lost(); }
});

$("baseline")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  try {
    const answer = await ask("POST", `/valves/${encodeURIComponent(form.dataset.valve)}/baseline`, { body: { test: form.dataset.test } });
    $("baseline-words").textContent = answer.ok ? t("Accepted: later tests are held against it.") : refusal(answer);
  } catch { lost(); }
});

$("analyze")?.addEventListener("click", async (event) => {
  const button = event.currentTarget;
  button.disabled = true;
  try {
    const answer = await ask("POST", `/tests/${button.dataset.test}/analyze`);
    if (answer.ok) { location.reload(); return; }
    trouble(refusal(answer));
  } catch { lost(); }
  button.disabled = false;
});
