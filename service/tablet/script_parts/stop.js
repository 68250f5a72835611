// Stop: one press, sent until it is answered.
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
        words.textContent = answer.found.stands ? `Stopped. ${answer.found.stands.sentence}` : "Stop is received.";
        if (page !== "running" && !isLocked) setTimeout(() => location.reload(), 1500);
        return;
      }
      isStopLost = answer.status === 401;
      const why = `STOP IS NOT SENT: ${refusal(answer).replace(/^You/, "you").replace(/\.$/, "")}.`;
      if (answer.status < 500) {
        words.textContent = `${why} ${answer.status === 401 ? "Sign in above, then press Stop again. " : ""}Use the means at the valve itself.`;
        break;
      }
      words.textContent = `${why} Trying on. Use the means at the valve itself.`;
    } catch {
      words.textContent = "STOP IS NOT SENT: no connection. Trying on. Use the means at the valve itself.";
    }
    await wait(700);
  }
  delete button.dataset.pressed;
  button.removeAttribute("aria-disabled");
});
