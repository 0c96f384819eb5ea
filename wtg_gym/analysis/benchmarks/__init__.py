"""What the environment costs: rates against other environments, growth with size, share of the machine's peak."""
