// Stop: one press, sent until it is answered.
$("stop")?.addEventListener("click", async (event) => {
  const button = event.currentTarget, words = $("stop-words");
  if (button.dataset.pressed) return;
  button.dataset.pressed = "yes";
  button.setAttribute("aria-disabled", "true");
  words.textContent = t("Stop is being sent…");
  for (;;) {
    try {
      const answer = await ask("POST", `/tests/${button.dataset.test}/stop`, { limitMs: online ? 10000 : 2000 });
      if (answer.ok) {
        words.textContent = answer.found.stands ? `${t("Stopped.")} ${answer.found.stands.sentence}` : t("Stop is received.");
        if (page !== "running" && !isLocked) setTimeout(() => location.reload(), 1500);
        return;
      }
      isStopLost = answer.status === 401;
      const why = t("STOP IS NOT SENT: {why}.", { why: refusal(answer).replace(/^You/, "you").replace(/\.$/, "") });
      if (answer.status < 500) {
        words.textContent = [why, ...(answer.status === 401 ? [t("Sign in above, then press Stop again.")] : []), t("Use the means at the valve itself.")].join(" ");
        break;
      }
      words.textContent = `${why} ${t("Trying on. Use the means at the valve itself.")}`;
    } catch {
      words.textContent = `${t("STOP IS NOT SENT: no connection.")} ${t("Trying on. Use the means at the valve itself.")}`;
    }
    await wait(700);
  }
  delete button.dataset.pressed;
  button.removeAttribute("aria-disabled");
});
