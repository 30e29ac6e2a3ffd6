"""The units of work, one kind per file; `base` says what a kind has, `local` runs them here."""
