// Begins once everything is there.
guard();
keepLooking();
setInterval(refresh, REFRESH_MS);
setInterval(() => { if ($("stands")?.dataset.verdict === "moving") refresh(); }, MOVING_MS);
document.addEventListener("visibilitychange", refresh);  // a tablet that wakes up looks at once
