// The list of valves is found as one types; without this script the form asks for it.
if ($("find")) {
  const FIND_MS = 200;
  let later = 0, latest = 0;

  const look = async () => {
    const mine = ++latest, address = new URL(location.href);
    address.searchParams.set("find", $("find").value);
    if (!$("find").value) address.searchParams.delete("find");
    address.searchParams.delete("page");
    history.replaceState(null, "", address);
    let answer;
    try { answer = await ask("GET", address.href); } catch { return; }  // the banner says that the line is lost
    if (mine !== latest) return;
    if (answer.status === 401 || new URL(answer.address).pathname === "/ui/sign-in") { lock(); return; }
    if (!answer.ok) { trouble(refusal(answer)); return; }
    renew(new DOMParser().parseFromString(answer.text, "text/html"));
    say($("found").textContent);
  };

  $("find").addEventListener("input", () => { clearTimeout(later); later = setTimeout(look, FIND_MS); });
}
