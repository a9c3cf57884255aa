"""Graphs over the objects of many constellations at once, and the maximum over neighbours on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

_ROUNDING = 1.0e-5  # a distance that equals the threshold is within it, however both were rounded


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """E pairs of neighbours among the M present objects of B constellations, padding left out.

    ``objects`` (E,) and ``neighbours`` (E,): rows of the features (M, C); each object has one pair at least. ``owners``
    (M,): which constellation an object belongs to.
    """

    objects: Tensor
    neighbours: Tensor
    owners: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhoods:
    """Sets of objects, ``count`` of them, and which of them each of the M present objects has as its neighbours.

    ``of`` (M,): the set of an object. ``groups`` (E,), ``members`` (E,): the sets and their objects, as rows of the
    features. ``owners`` (M,): which constellation an object belongs to.
    """

    of: Tensor
    groups: Tensor
    members: Tensor
    count: int
    owners: Tensor


def distances(points: Tensor) -> Tensor:
    """Distances (B, N, N) between the objects of each constellation, from points (B, N, C)."""
    # The default takes scalar products from 26 objects on: inexact, and another result with more padding.
    return torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")


def nearest(points: Tensor, present: Tensor, count: int) -> Tensor:
    """Which objects are among the ``count`` nearest of each (B, N, N), the object itself counted, present ones only.

    All that are as near as the last one are taken too, or the order of the objects would decide.

    Args:
        points: (B, N, C), in any space.
        present: (B, N) bool.
    """
    both = present[:, :, None] & present[:, None, :]
    apart = distances(points).masked_fill(~both, torch.inf)
    last = apart.topk(min(count, apart.shape[2]), dim=2, largest=False).values[:, :, -1:]
    return both & (apart <= last * (1.0 + _ROUNDING) + _ROUNDING)


def edges(positions: Tensor, present: Tensor, length_m: float) -> Tensor:
    """Which objects are neighbours (B, N, N): both present and within ``length_m`` of each other, or the same.

    Args:
        positions: (B, N, 3) m.
        present: (B, N) bool.
        length_m: the threshold.
    """
    return _within(distances(positions), present, length_m)


def neighbourhoods_of(apart_m: Tensor, present: Tensor, length_m: float) -> Neighbourhoods:
    """The neighbourhoods of the M present objects, an edge joining all that are within ``length_m``.

    The paper's threshold is the average distance between two nodes of the global map (Descriptellation, Section III-A),
    on a street hundreds of metres: nearly all constellations are complete graphs, of whose objects all have one and the
    same neighbourhood.

    Args:
        apart_m: (B, N, N) m, as :func:`distances` gives them.
        present: (B, N) bool.
        length_m: the threshold.
    """
    connected = _within(apart_m, present, length_m)
    both = present[:, :, None] & present[:, None, :]
    is_complete = (connected == both).all(dim=2).all(dim=1)
    owners = present.nonzero(as_tuple=True)[0]
    pairs = pairs_of(connected & ~is_complete[:, None, None], present)
    objects = torch.arange(len(owners), device=present.device)
    alone = ~is_complete[owners]
    # Groups: first the objects with a neighbourhood of their own, then the complete constellations.
    own = torch.cumsum(alone, dim=0) - 1
    whole = int(alone.sum()) + torch.cumsum(is_complete, dim=0) - 1
    return Neighbourhoods(
        of=torch.where(alone, own, whole[owners]),
        groups=torch.cat([own[pairs.objects], whole[owners[~alone]]]),
        members=torch.cat([pairs.neighbours, objects[~alone]]),
        count=int(alone.sum()) + int(is_complete.sum()),
        owners=owners,
    )


def _within(apart_m: Tensor, present: Tensor, length_m: float) -> Tensor:
    both = present[:, :, None] & present[:, None, :]
    itself = torch.eye(present.shape[1], dtype=torch.bool, device=present.device)
    return both & ((apart_m <= length_m * (1.0 + _ROUNDING)) | itself)


def pairs_of(connected: Tensor, present: Tensor) -> Pairs:
    """The edges (B, N, N) as pairs of rows of the present objects' features, ``present`` (B, N)."""
    rows = (torch.cumsum(present.flatten(), dim=0) - 1).view(present.shape)
    constellations, objects, neighbours = connected.nonzero(as_tuple=True)
    owners = present.nonzero(as_tuple=True)[0]
    return Pairs(rows[constellations, objects], rows[constellations, neighbours], owners)


def group_maximum(features: Tensor, groups: Tensor, count: int, members: Tensor | None = None) -> Tensor:
    """The largest value (count, C) of each channel over the members of each group.

    Where several members are largest they share the gradient, as with ``torch.amax``.

    Args:
        features: (M, C).
        groups: (E,) the group in 0 to ``count`` - 1 that each member belongs to; every group has one at least.
        members: (E,) rows of ``features``; without them row e is member e.
    """
    return _GroupMaximum.apply(features, groups, count, members)  # type: ignore[no-any-return, no-untyped-call]


class _GroupMaximum(torch.autograd.Function):
    """With its own derivative 2 ms for 25000 pairs of 32 channels, where torch's of ``scatter_reduce`` takes 7 ms."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, groups: Tensor, count: int, members: Tensor | None) -> Tensor:
        values = features if members is None else features.index_select(0, members)
        largest = features.new_empty(count, features.shape[1])
        largest.scatter_reduce_(0, groups[:, None].expand_as(values), values, "amax", include_self=False)
        ctx.save_for_backward(features, groups, members, largest)
        return largest

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, None]:
        features, groups, members, largest = ctx.saved_tensors
        values = features.clone() if members is None else features.index_select(0, members)
        # 1 where a member is largest and 0 elsewhere; comparisons and masks take several times as long as the sign.
        is_largest = values.sub_(largest.index_select(0, groups)).sign_().add_(1.0)
        shares = gradients[0] / torch.zeros_like(largest).index_add_(0, groups, is_largest)
        passed = is_largest.mul_(shares.index_select(0, groups))
        if members is not None:
            passed = torch.zeros_like(features).index_add_(0, members, passed)
        return passed, None, None, None
