"""Branches of a kernel as choices between numbers, so that it can be traced.

Equations say `select`; protections and lost governors are written with `if`. Here such a
kernel's own source is changed so that both sides of an `if` run, one after the other, where the condition is a traced
number: stores in :class:`Cells` and assignments of a side take effect where its condition holds. Plain conditions
branch as always. Both sides of `and` and `or` are evaluated.
"""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients.tracing import Rows

#: Conditions of the sides that are running, from the outermost to the innermost.
_CONDITIONS: list[Any] = []
#: Value of a name before its assignment.
_UNSET = object()


def is_finite(value: Any) -> Any:
    """Return whether a number is neither infinite nor undefined."""
    return ex.number("finite", value) if isinstance(value, ex.Number) else math.isfinite(value)


class Cells(Rows):
    """Numbers that a kernel stores; where a side of a branch is not taken they stay what they were."""

    def __setitem__(self, place: int, value: Any) -> None:
        for condition in reversed(_CONDITIONS):
            value = ex.select(condition, value, self[place])
        super().__setitem__(place, value)


@contextmanager
def where(condition: Any) -> Iterator[None]:
    """Let what is stored in :class:`Cells` count where a condition holds."""
    _CONDITIONS.append(condition)
    try:
        yield
    finally:
        _CONDITIONS.pop()


class _Branch:
    """An `if` while it runs: one side after the other where the condition is traced, else the one that holds."""

    def __init__(self, condition: Any, held: tuple[Any, ...]) -> None:
        self._condition, self._held, self._found = condition, held, held
        self._traced = isinstance(condition, ex.Number)

    def first(self) -> bool:
        if self._traced:
            _CONDITIONS.append(self._condition)
        return self._traced or bool(self._condition)

    def between(self, *held: Any) -> tuple[Any, ...]:
        if not self._traced:
            return held
        _CONDITIONS.pop()
        self._found = held
        return self._held

    def second(self) -> bool:
        if self._traced:
            _CONDITIONS.append(_negation(self._condition))
        return self._traced or not self._condition

    def end(self, *held: Any) -> tuple[Any, ...]:
        if not self._traced:
            return held
        _CONDITIONS.pop()
        return tuple(_chosen(self._condition, *pair) for pair in zip(self._found, held, strict=True))


def _chosen(condition: Any, value: Any, other: Any) -> Any:
    if value is other or other is _UNSET:
        return value
    if value is _UNSET:
        return other
    if isinstance(value, tuple):
        return type(value)(*(_chosen(condition, *pair) for pair in zip(value, other, strict=True)))
    return ex.select(condition, value, other)


def _negation(value: Any) -> Any:
    return ex.number("not", value) if isinstance(value, ex.Number) else not value


def _both(first: Any, *others: Any) -> Any:
    for other in others:
        traced = isinstance(first, ex.Number) or isinstance(other, ex.Number)
        first = ex.number("and", first, other) if traced else first and other
    return first


def _either(first: Any, *others: Any) -> Any:
    for other in others:
        traced = isinstance(first, ex.Number) or isinstance(other, ex.Number)
        first = ex.number("or", first, other) if traced else first or other
    return first


_HELPERS = {"_Branch": _Branch, "_UNSET": _UNSET, "_negation": _negation, "_both": _both, "_either": _either}


def without_branches(function: Any) -> Callable[..., Any]:
    """Return a compiled function's source as a plain function whose branches are choices.

    It has no returns but its last line, and `continue` stands at the end of an `if` of its loop.
    """
    source = getattr(function, "py_func", function)
    tree = ast.parse(textwrap.dedent(inspect.getsource(source)))
    (definition,) = tree.body
    assert isinstance(definition, ast.FunctionDef) and source.__closure__ is None
    definition.decorator_list = []
    names = _assigned(definition.body)
    definition.body = _Choices().statements(definition.body)
    definition.body[:0] = ast.parse("".join(f"{name} = _UNSET\n" for name in names)).body
    space = {**source.__globals__, **_HELPERS}
    ast.increment_lineno(tree, source.__code__.co_firstlineno - 1)
    # Annotations are not evaluated: `compile` inherits this module's import from the future.
    exec(compile(ast.fix_missing_locations(tree), source.__code__.co_filename, "exec"), space)
    found: types.FunctionType = space[source.__name__]
    return found


def _assigned(statements: list[ast.stmt]) -> list[str]:
    found = {
        node.id
        for statement in statements
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }
    return sorted(found)


class _Choices(ast.NodeTransformer):
    def __init__(self) -> None:
        self._n = 0

    def statements(self, given: list[ast.stmt]) -> list[ast.stmt]:
        """Return statements with each `if` as a :class:`_Branch`; statements after a `continue` are its other side."""
        found: list[ast.stmt] = []
        for place, statement in enumerate(given):
            if isinstance(statement, ast.If) and isinstance(statement.body[-1], ast.Continue):
                rest = [*statement.orelse, *given[place + 1 :]]
                return found + self._branch(statement.test, statement.body[:-1], rest)
            if isinstance(statement, ast.If):
                found += self._branch(statement.test, statement.body, statement.orelse)
            elif isinstance(statement, ast.For):
                statement.body = self.statements(statement.body)
                found.append(statement)
            else:
                found.append(self.visit(statement))
        return found

    def _branch(self, test: ast.expr, first: list[ast.stmt], second: list[ast.stmt]) -> list[ast.stmt]:
        own = f"_branch_{self._n}"
        self._n += 1
        held = ", ".join(_assigned([*first, *second]))
        names = f"{held}, = " if held else ""
        lines = (
            f"{own} = _Branch(None, ({held}{',' if held else ''}))\n"
            f"if {own}.first():\n    pass\n"
            f"{names}{own}.between({held})\n"
            f"if {own}.second():\n    pass\n"
            f"{names}{own}.end({held})\n"
        )
        found: Any = ast.parse(lines).body
        found[0].value.args[0] = self.visit(test)
        found[1].body = self.statements(first) or found[1].body
        found[3].body = self.statements(second) or found[3].body
        return list(found)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        name = "_both" if isinstance(node.op, ast.And) else "_either"
        return ast.Call(ast.Name(name, ast.Load()), [self.visit(value) for value in node.values], [])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        if isinstance(node.op, ast.Not):
            return ast.Call(ast.Name("_negation", ast.Load()), [self.visit(node.operand)], [])
        self.generic_visit(node)
        return node
