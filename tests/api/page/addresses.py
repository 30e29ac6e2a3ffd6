"""Pages that are always there."""

LISTS = ["/", "/submit", "/compare", "/criticisms", "/robots", "/datasets", "/claims", "/docs"]
