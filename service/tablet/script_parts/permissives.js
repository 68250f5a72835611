// Permissives: asked of the device, shown one by one with what to do.
const CALLED = { owner: t("another master"), output: t("signal to the I/P"), disk: t("room on the disk") };
let mayStart = null;

function permissive(one) {
  const [sign, words] = one.met === true ? ["✓", t("met")] : one.met === false ? ["✗", t("MISSING")] : ["?", t("not known")];
  const item = element("li", "", one.met === true ? "met" : one.met === false ? "missing" : "unknown");
  item.append(element("span", sign, "sign"));
  item.lastChild.setAttribute("aria-hidden", "true");
  const said = element("div"), name = CALLED[one.name] ?? t(one.name.replaceAll("_", " "));
  if (one.met === true) {
    said.append(element("strong", name), element("span", ` ${t("met")}: `, "unseen"), element("span", ` ${one.value}`, "aside"));
  } else {
    said.append(element("strong", name), element("span", `: ${words}`));
    said.append(element("div", [one.value, one.limit && t("needed: {limit}", { limit: one.limit })].filter(Boolean).join("; "), "aside"));
    if (one.name === "last_test" && one.met === false) {
      const isHere = Boolean($("acknowledge"));
      const link = element("a", isHere ? t("Look at the valve, then say so above") : t("Look at the valve, then say so on its page"), "remedy");
      link.href = isHere ? "#h-ack" : `/ui/valves/${encodeURIComponent($("permissives").dataset.valve)}`;
      said.append(link);
    } else if (one.name === "permit" && one.met === false) {
      said.append(element("div", $("permit") ? t("Enter the work permit's number") : t("Its number is asked for where a test is started"), "remedy"));
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
    place.replaceChildren(element("p", t("The gateway did not answer: look again.")));
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
    const missing = answer.found.permissives.filter((one) => one.met === false).length, notFresh = answer.found.not_fresh_because;
    const no = missing === 1 ? t("No, this is missing:") : missing ? t("No, these are missing:") : notFresh ? t("No: {why}.", { why: notFresh }) : t("No.");
    const sum = element("p", mayStart ? t("Yes, all is there.") : no, mayStart ? "sum" : missing ? "sum missing" : "sum");
    const readAt = Date.parse(answer.found.read_at) || Date.now(), isOld = Date.now() - readAt > 15000;
    const age = (isOld ? t("Last known, read from the device at {at}", { at: clock(readAt) }) : t("Read from the device at {at}", { at: clock(readAt) }));
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
