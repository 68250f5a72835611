// Permissives: asked of the device, shown one by one with what to do.
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
    const missing = answer.found.permissives.filter((one) => one.met === false).length, notFresh = answer.found.not_fresh_because;
    const no = missing ? `No, ${missing === 1 ? "this is" : "these are"} missing:` : notFresh ? `No: ${notFresh}.` : "No.";
    const sum = element("p", mayStart ? "Yes, all is there." : no, mayStart ? "sum" : missing ? "sum missing" : "sum");
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
