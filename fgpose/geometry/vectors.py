"""Products of many vectors. Those of vectors of three are taken component by component: numpy's cross takes half as
long again, a sum over an axis of three four times as long."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def dot(a: Float[np.ndarray, "*#vectors 3"], b: Float[np.ndarray, "*#vectors 3"]) -> Float[np.ndarray, "*vectors"]:
    """Scalar product of each pair."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def norm(vectors: Float[np.ndarray, "*vectors dimension"]) -> Float[np.ndarray, "*vectors"]:
    """Length of each. np.linalg.norm takes twice as long, of few vectors and of many."""
    return np.asarray(np.sqrt(np.vecdot(vectors, vectors)))


def cross(a: Float[np.ndarray, "*#vectors 3"], b: Float[np.ndarray, "*#vectors 3"]) -> Float[np.ndarray, "*vectors 3"]:
    """Vector product of each pair."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape), dtype=np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return product
