"""The functions of torch that a mechanism may use, on numbers: what `torch` is in code compiled for a GPU."""

from __future__ import annotations

import math


def where(condition, one, other):
    return one if condition else other


def minimum(one, other):
    return one if one < other else other


def maximum(one, other):
    return one if one > other else other


def clamp(value, least, most):
    return most if value > most else (least if value < least else value)


def sign(value):
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


def remainder(value, divisor):
    return value % divisor


def logical_not(value):
    return not value


def abs(value):
    return -value if value < 0.0 else value


def exp(value):
    return math.exp(value)


def log(value):
    return math.log(value)


def sqrt(value):
    return math.sqrt(value)


def sin(value):
    return math.sin(value)


def cos(value):
    return math.cos(value)


def tanh(value):
    return math.tanh(value)


def floor(value):
    return 0.0 * value + math.floor(value)
