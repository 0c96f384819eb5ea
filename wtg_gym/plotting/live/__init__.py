"""The page of `wtg-gym play`: `match` is what happens, `play_page` shows it, and `server` serves it on this machine."""
