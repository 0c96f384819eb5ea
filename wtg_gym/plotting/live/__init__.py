"""The page of `wtg-gym play`: holding the frequency by hand.

`episode` and `match` hold what happens, without Bokeh; `play_page` shows it, `look` is what it looks like, and `server`
serves it on this machine.
"""
