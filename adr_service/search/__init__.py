"""Search algorithms that methods share."""
