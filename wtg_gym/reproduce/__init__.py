"""What `wtg-gym reproduce` needs: steady states, single-machine loops, the paper's claims and its figures."""
