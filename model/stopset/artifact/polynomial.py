"""Polynomials of the model file, and their compiled evaluation.

A polynomial is stored as a plain list of monomials, readable by anyone.  For evaluation, several of them share one
table in which every monomial is an earlier one times one variable, so a value costs one product per monomial and a
Jacobian twice that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import ffi, given, integers, lib, view
from stopset.types import Array

Integers = NDArray[np.int64]
MOST_POWER = 255  # of a variable: monomials are sorted as strings of bytes


@dataclass(frozen=True, slots=True)
class Polynomial:
    """``sum_k coefficient[k] * prod_i z_i^exponent[k, i]``; ``exponent``: (m, d) small integers; ``coefficient``: (m,)
    numbers.
    """

    exponent: Integers
    coefficient: Array

    def __call__(self, z: Array) -> Array:
        """Values at the rows of ``z`` (N, d) -> (N,)."""
        return evaluate(compiled((self,)), np.atleast_2d(np.asarray(z, float)))[:, 0]

    def recentred(self, centre: Array, cut: int | None = None) -> Polynomial:
        """The same function written in the deviation from ``centre`` (d,): ``P.recentred(a)(w) == P(a + w)``.

        Binomial expansion, one variable after the other; monomials that cancel to zero are dropped, and so are those of a
        total degree above ``cut``, as soon as the variables done have it: what is left is the same to the bit.
        """
        e, c = self.exponent, self.coefficient
        done = np.asarray(centre) == 0
        for i in np.flatnonzero(np.asarray(centre)):
            power = e[:, i]
            rows = np.repeat(np.arange(power.size), power + 1)
            degree = np.arange(rows.size) - np.repeat(np.cumsum(power + 1) - power - 1, power + 1)  # 0..power of each row
            table = _binomials(int(power.max(initial=0)))
            new_c = c[rows] * table[power[rows], degree] * centre[i] ** (power[rows] - degree)
            new_e = e[rows].copy()
            new_e[:, i] = degree
            done[i] = True
            if cut is not None:
                low = new_e[:, done].sum(axis=1) <= cut
                new_e, new_c = new_e[low], new_c[low]
            e, c = collected(new_e, new_c)
        if cut is not None:
            low = e.sum(axis=1) <= cut
            e, c = e[low], c[low]
        return Polynomial(e, c)


def _binomials(n: int) -> Array:
    """(n+1, n+1) Pascal's triangle."""
    table = np.zeros((n + 1, n + 1))
    for k in range(n + 1):
        table[k, 0] = 1.0
        table[k, 1 : k + 1] = table[k - 1, :k] + table[k - 1, 1 : k + 1]
    return table


def _rows(exponent: Integers) -> NDArray[np.bytes_]:
    """One sortable byte string per monomial."""
    if exponent.shape[1] == 0:
        return np.zeros(exponent.shape[0], "S1")
    return np.ascontiguousarray(exponent.astype(np.uint8)).view(f"S{exponent.shape[1]}").ravel()


def collected(exponent: Integers, coefficient: Array) -> tuple[Integers, Array]:
    """Equal monomials added up, zeros dropped; sorted."""
    _, first, where = np.unique(_rows(exponent), return_index=True, return_inverse=True)
    total = np.bincount(where.ravel(), weights=coefficient, minlength=first.size)
    keep = total != 0.0
    return exponent[first][keep], total[keep]


class Program(NamedTuple):
    """Several polynomials over one monomial table: monomial k = monomial ``parent[k]`` times ``z[variable[k]]``; number
    0 is 1.

    ``coefficient``: (m, number of polynomials).
    """

    parent: Integers
    variable: Integers
    coefficient: Array
    dimension: int


def compiled(polynomials: Sequence[Polynomial]) -> Program:
    """One table for all monomials of ``polynomials`` (at least one, all in the same variables)."""
    d = polynomials[0].exponent.shape[1]
    exponent = np.vstack([np.zeros((1, d), np.int64), *(p.exponent for p in polynomials)])
    _, first = np.unique(_rows(exponent), return_index=True)
    table = exponent[first]
    # close the table downwards: every monomial's parent (last variable's power less one) must be in it
    level = table
    while level.size:
        parents = _parents(level[level.any(axis=1)])[0]
        new = np.setdiff1d(_rows(parents), _rows(table)) if parents.size else np.zeros(0, "S1")
        if not new.size:
            break
        level = np.frombuffer(new.astype(f"S{d}").tobytes(), np.uint8).reshape(-1, d).astype(np.int64)
        table = np.vstack([table, level])
    table = table[np.lexsort((*table.T, table.sum(axis=1)))]
    names = _rows(table)
    order = np.argsort(names)
    up, last = _parents(table[1:])
    parent = np.zeros(table.shape[0], np.int64)
    variable = np.zeros(table.shape[0], np.int64)
    if up.size:
        parent[1:], variable[1:] = order[np.searchsorted(names, _rows(up), sorter=order)], last
    coefficient = np.zeros((table.shape[0], len(polynomials)))
    for k, p in enumerate(polynomials):
        np.add.at(coefficient[:, k], order[np.searchsorted(names, _rows(p.exponent), sorter=order)], p.coefficient)
    return Program(parent, variable, coefficient, d)


def _parents(exponent: Integers) -> tuple[Integers, Integers]:
    """Monomials with one power of their last variable taken off, and which variable that was."""
    d = exponent.shape[1]
    last = d - 1 - np.argmax(exponent[:, ::-1] > 0, axis=1)
    up = exponent.copy()
    up[np.arange(up.shape[0]), last] -= 1
    return up, last


def struct_of(program: Program) -> tuple[Any, Program]:
    """``StopsetPolynomials``, and what must live as long."""
    return ffi.new("StopsetPolynomials *", (
        *program.coefficient.shape, program.dimension, integers(program.parent), integers(program.variable), view(program.coefficient),
    )), program  # fmt: skip


def _table(program: Program, z: Array) -> Any:
    """``StopsetPolynomials`` of a program whose arrays outlive it, for the rows of ``z``."""
    if z.ndim != 2 or z.shape[1] != program.dimension:
        raise ValueError(f"arguments of shape {z.shape}; expected rows of {program.dimension}")
    return struct_of(program)[0]


def evaluate(program: Program, z: Array) -> Array:
    """Values at the rows of ``z`` (N, d) -> (N, number of polynomials)."""
    m, n = program.coefficient.shape
    out, work, z = np.empty((len(z), n)), np.empty(m), given(z)
    lib.stopset_polynomials(_table(program, z), len(z), view(z), view(work), view(out))
    return out
