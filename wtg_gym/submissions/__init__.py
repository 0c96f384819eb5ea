"""Policies of others: data that is looked at before it is played, and played in a process that can do no harm.

Nothing is imported here: the process that plays a policy imports as little of the package as it can.
"""
