"""Which descriptors there are, and the index that each is looked up in."""

from __future__ import annotations

from collections.abc import Callable

from descriptors.baselines.gosmatch import GosmatchGraph, GosmatchVertex
from descriptors.baselines.onion import Onion, OnionHistogram
from descriptors.baselines.random_walk import RandomWalk
from descriptors.descriptor import Descriptor
from descriptors.errors import DescriptorError
from descriptors.index import ConstellationIndex, VectorIndex
from descriptors.likelihood_index import LikelihoodIndex
from descriptors.random_vector import RandomVector
from descriptors.ring_likelihood import RingLikelihood

HANDCRAFTED: dict[str, Callable[[], Descriptor]] = {
    "onion": Onion,
    "onion_histogram": OnionHistogram,
    "random_walk": RandomWalk,
    "gosmatch_graph": GosmatchGraph,
    "gosmatch_vertex": GosmatchVertex,
}
LEARNED = ("descriptellation", "pointnet", "sgnet")
DESCRIPTOR_NAMES = (RingLikelihood.name, *LEARNED, *HANDCRAFTED, RandomVector.name)


def make_descriptor(name: str) -> Descriptor:
    """The descriptor of that name, with its default parameters; a learned one with the weights that ship.

    Raises:
        DescriptorError: there is none of that name, or its weights do not fit.
    """
    if name == RingLikelihood.name:
        return RingLikelihood()
    if name == RandomVector.name:
        return RandomVector()
    if name in HANDCRAFTED:
        return HANDCRAFTED[name]()
    if name in LEARNED:
        from descriptors.learned.network_descriptor import LearnedDescriptor  # loads torch

        return LearnedDescriptor.shipped(name)
    raise DescriptorError(f"no descriptor {name!r}; there are {', '.join(DESCRIPTOR_NAMES)}")


def make_index(name: str) -> ConstellationIndex:
    """An empty index for constellations, with that descriptor.

    Raises:
        DescriptorError: there is none of that name, or its weights do not fit.
    """
    descriptor = make_descriptor(name)
    return LikelihoodIndex(descriptor) if isinstance(descriptor, RingLikelihood) else VectorIndex(descriptor)
