"""What the kernel lets the process of a stranger's policy do: use memory, read its requests, write its answers, end.

A filter of system calls (seccomp) on Linux. It lists what is allowed, so all else is refused, also what kernels will
learn one day: to open, list, rename or remove files, sockets of any kind, other processes, threads, programs, signals.
"""

from __future__ import annotations

import ctypes
import os
import sys

#: How the kernel calls a kind of processor, and the number of `seccomp` there.
_MACHINES = {"x86_64": (0xC000_003E, 317), "aarch64": (0xC000_00B7, 277)}
#: Numbers of what is allowed, on both.
_ALLOWED = {
    "brk": (12, 214),
    "clock_gettime": (228, 113),
    "clock_nanosleep": (230, 115),
    "exit": (60, 93),
    "exit_group": (231, 94),
    "futex": (202, 98),
    "getpid": (39, 172),
    "getrandom": (318, 278),
    "madvise": (28, 233),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    "restart_syscall": (219, 128),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sched_getaffinity": (204, 123),
    "sched_yield": (24, 124),
}
_READ, _WRITE, _MMAP = (0, 63), (1, 64), (9, 222)
_MAP_ANONYMOUS = 0x20
#: Classic BPF: load a word of the call's description, compare it, test its bits, return a verdict.
_LOAD, _EQUAL, _ANY_BIT, _RETURN = 0x20, 0x15, 0x45, 0x06
#: Where the call's number, the kind of processor, and the lower halves of its first and fourth argument stand.
_NUMBER, _MACHINE, _FIRST, _FOURTH = 0, 4, 16, 40
_ALLOW, _REFUSE, _KILL = 0x7FFF_0000, 0x0005_0000 | 1, 0x8000_0000
_SET_MODE_FILTER, _ALL_THREADS = 1, 1
_PR_SET_NO_NEW_PRIVS = 38


class _Instruction(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8), ("value", ctypes.c_uint32))


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_uint16), ("instructions", ctypes.POINTER(_Instruction)))


def lock(source: int, sink: int) -> str:
    """Take from this process, for good, all but computing, reading `source` and writing `sink`.

    Args:
        source: the only file descriptor that may be read.
        sink: the only one that may be written.

    Returns:
        what this system would not take away; empty where it did.
    """
    machine = os.uname().machine if sys.platform == "linux" else sys.platform
    if machine not in _MACHINES or sys.maxsize < 2**32:
        return f"no filter of system calls: there is none for {machine}"
    column = list(_MACHINES).index(machine)
    kind, seccomp = _MACHINES[machine]
    lines = _filter(kind, column, source, sink)
    instructions = (_Instruction * len(lines))(*(_Instruction(*line) for line in lines))
    program = _Program(len(lines), instructions)
    libc = ctypes.CDLL(None, use_errno=True)
    # Without it only root may set a filter; no program can give the process more rights any more.
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    if libc.syscall(seccomp, _SET_MODE_FILTER, _ALL_THREADS, ctypes.byref(program)) != 0:
        return f"no filter of system calls: the kernel refuses it ({os.strerror(ctypes.get_errno())})"
    return ""


def _filter(kind: int, column: int, source: int, sink: int) -> list[tuple[int, int, int, int]]:
    """Return the filter as instructions (code, lines to skip if true, if false, value)."""
    lines = [(_LOAD, 0, 0, _MACHINE), (_EQUAL, 1, 0, kind), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, _NUMBER)]
    # Memory only, never a file seen as memory.
    for numbers, argument, test, value in (
        (_READ, _FIRST, _EQUAL, source),
        (_WRITE, _FIRST, _EQUAL, sink),
        (_MMAP, _FOURTH, _ANY_BIT, _MAP_ANONYMOUS),
    ):
        lines += [(_EQUAL, 0, 4, numbers[column]), (_LOAD, 0, 0, argument), (test, 0, 1, value)]
        lines += [(_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _REFUSE)]
    for numbers in _ALLOWED.values():
        lines += [(_EQUAL, 0, 1, numbers[column]), (_RETURN, 0, 0, _ALLOW)]
    return [*lines, (_RETURN, 0, 0, _REFUSE)]


__all__ = ["lock"]
