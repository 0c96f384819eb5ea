"""The grids that come with the package, as files, and readers of cases of other programs."""
