"""Equations over units and environments as machine code, forward and back.

In the order in which they are best read:

    elementary      functions without branches that equations use
    systems         records of named numbers; kinds of unit, and systems: pure functions of one unit
    programs        ordered lists of equations and control blocks (if, loop, product, delay), and their memory map
    expressions     an equation becomes operations, and these pulled back
    vectors         operations become instructions on the environments of a block
    writers         loops over units, the tape, the way back
    routines        programs become machine code, kept on disk and called at an address
    compiled        functions with loops, compiled by numba; the cache
"""
