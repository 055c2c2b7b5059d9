"""Whether two machines compute the same sines: what a match depends on besides the engine.

glibc chooses between variants of these functions by the processor, with and without fused
multiplication and addition, and has changed some of them between its versions. Their last bits
differ, and with them all that follows in a match.
"""

from __future__ import annotations

import ctypes
import hashlib
import random
from array import array

# All of libm that pip's build of the engine asks for, but what has only one right result (square
# root, remainder, rounding).
_OF_FLOAT = ("acosf", "asinf", "cosf", "sinf", "tanf")
_OF_TWO_FLOATS = ("atan2f", "powf")
_OF_DOUBLE = ("acos", "cos", "sin", "tan")
_OF_TWO_DOUBLES = ("pow",)
_INPUTS = 4000


def fingerprint() -> str:
    """A hash of the functions' results for fixed inputs; equal where matches are."""
    libm = ctypes.CDLL("libm.so.6")
    generator = random.Random(1)
    results = array("d")
    for names, number, kind in (
        (_OF_FLOAT, 1, ctypes.c_float),
        (_OF_TWO_FLOATS, 2, ctypes.c_float),
        (_OF_DOUBLE, 1, ctypes.c_double),
        (_OF_TWO_DOUBLES, 2, ctypes.c_double),
    ):
        for name in names:
            function = getattr(libm, name)
            function.restype, function.argtypes = kind, [kind] * number
            # Angles and coordinates; where a function has a narrower range, what lies in it.
            high = 1.0 if name.startswith(("acos", "asin")) else 8.0
            low = 0.0 if name.startswith("pow") else -high
            for _ in range(_INPUTS):
                inputs = [low + (high - low) * generator.random() for _ in range(number)]
                results.append(function(*inputs))
    return hashlib.sha256(results.tobytes()).hexdigest()[:16]
