// Begins once everything is there.
guard();
keepLooking();
setInterval(refresh, REFRESH_MS);
