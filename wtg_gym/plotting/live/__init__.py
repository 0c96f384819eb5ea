"""Live pages in the browser: holding the frequency by hand, and trying out wind, events, laws and grids.

`episode`, `match` and `experiment` hold what happens, without Bokeh; `play_page` and `explore_page` show it, `look` is
what both look like, and `server` serves one of them on this machine.
"""
