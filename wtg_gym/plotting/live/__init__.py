"""The page of `wtg-gym play`: `match` is what happens, and `play_page` shows it."""
