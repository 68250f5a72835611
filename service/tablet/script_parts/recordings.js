// A file that exists already: sent, and what it says shown beside what was understood of it.
const ANALYSIS_LIMIT_MS = 900000;

function rows(heads, lines) {
  const table = element("table"), head = element("tr");
  for (const one of heads) { const cell = element("th", one); cell.scope = "col"; head.append(cell); }
  table.append(head);
  for (const line of lines) {
    const row = element("tr");
    for (const one of line) row.append(element("td", one));
    table.append(row);
  }
  return table;
}

function showAnalysed({ recording, summary }) {
  const shown = [];
  for (const line of summary.verdict) shown.push(element("p", line, "big"));
  shown.push(rows(["", ""], summary.lines.map((one) => [one.name, one.words])));
  for (const note of summary.notes) shown.push(element("p", t("Note: {note}", { note })));
  for (const file of recording.understood ?? []) {
    shown.push(element("h3", `${file.file}: ${file.kind}`));
    shown.push(rows([t("Read as"), t("Column of the file"), t("Unit"), t("How")], file.columns.map((one) => [one.column, one.header, one.unit, one.how])));
    if (file.not_used.length) shown.push(element("p", t("Not used: {columns}", { columns: file.not_used.join(", ") })));
    for (const remark of file.remarks) shown.push(element("p", remark));
  }
  $("analysed-words").replaceChildren(...shown);
  $("analysed").hidden = false;
}

$("analyse")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget, words = $("analyse-words"), button = form.querySelector("button"), body = new FormData();
  for (const file of form.elements.recording.files) body.append("recording", file);
  if (form.elements.valve.value) body.append("valve", form.elements.valve.value);
  else if (form.elements.nameplate.files.length) body.append("nameplate", form.elements.nameplate.files[0]);
  if (form.elements.map.value.trim()) body.append("map", form.elements.map.value);
  button.disabled = true;
  $("analysed").hidden = true;
  words.textContent = t("Analysing: this takes a minute, of a long recording more.");
  try {
    const answer = await fetch("/recordings/analyze", {
      method: "POST", body, headers: { ...readerHeaders(), ...(csrf ? { "X-CSRF-Token": csrf } : {}) }, cache: "no-store", credentials: "same-origin",
      signal: AbortSignal.timeout(ANALYSIS_LIMIT_MS),
    });
    const found = await answer.json().catch(() => null);
    words.textContent = answer.ok ? "" : refusal({ status: answer.status, found });
    if (answer.ok) showAnalysed(found);
  } catch { words.textContent = t("The gateway did not answer: try again."); }
  button.disabled = false;
});
