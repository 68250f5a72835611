"""What outlives the process: metadata in a database, recordings and journals as files beside it."""
