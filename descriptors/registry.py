"""Which descriptors there are, and the index that each is looked up in."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

from descriptors.baselines import GosmatchVertex, RandomVector
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.descriptor import Descriptor
from descriptors.errors import DescriptorError
from descriptors.index import VectorIndex
from descriptors.learned.weights import read_weights
from descriptors.own_class import OwnDescriptor

PAPER = "descriptellation"
LEARNED = (LearnedLikelihood.name, PAPER)
HANDCRAFTED: dict[str, Callable[[], Descriptor]] = {each.name: each for each in (GosmatchVertex, RandomVector)}
DESCRIPTOR_NAMES = (*LEARNED, *HANDCRAFTED)
WEIGHTS_SUFFIX = ".safetensors"


def shipped_weights(name: str) -> Path:
    """The file of the weights of one of :data:`LEARNED`."""
    return Path(__file__).parent / "weights" / f"{name}{WEIGHTS_SUFFIX}"


@cache
def shipped_likelihood() -> LearnedLikelihood:
    """The learned likelihood ratio with its shipped weights."""
    return LearnedLikelihood(shipped_weights(LearnedLikelihood.name))


def make_descriptor(name: str) -> Descriptor | LearnedLikelihood:
    """A descriptor: one of :data:`DESCRIPTOR_NAMES`, a file of weights, or a class of one's own as ``module:Class``.

    A class of one's own is imported, from the current folder too, and made without arguments; it does what
    :class:`Descriptor` says.

    Raises:
        DescriptorError: there is none of that name, weights that do not fit, or a class that cannot be made.
    """
    if name == LearnedLikelihood.name:
        return shipped_likelihood()
    if name in HANDCRAFTED:
        return HANDCRAFTED[name]()
    if name == PAPER:
        return _from_weights(shipped_weights(name))
    if name.endswith(WEIGHTS_SUFFIX):
        return _from_weights(Path(name))
    if ":" in name:
        return OwnDescriptor(name)
    raise DescriptorError(
        f"unknown descriptor {name!r}; choose one of {', '.join(DESCRIPTOR_NAMES)}, weights by their path "
        f"(NAME{WEIGHTS_SUFFIX}), or a class of your own (module:Class)"
    )


def make_index(name: str) -> PairIndex | VectorIndex:
    """An empty index with that descriptor: of pairs for the likelihood ratio, else of vectors.

    Raises:
        DescriptorError: as :func:`make_descriptor`.
    """
    descriptor = make_descriptor(name)
    if isinstance(descriptor, LearnedLikelihood):
        return PairIndex(descriptor)
    return VectorIndex(descriptor, of_own_class=descriptor.name != PAPER)


def _from_weights(path: Path) -> Descriptor | LearnedLikelihood:
    if read_weights(path).architecture.get("name") == LearnedLikelihood.name:
        return LearnedLikelihood(path)
    try:
        from descriptors.learned.networks import LearnedDescriptor  # loads torch
    except ModuleNotFoundError as error:
        raise DescriptorError(
            f"the descriptor {path.stem} is a network and needs torch: pip install 'descriptellation-slam[learn]'"
        ) from error
    return LearnedDescriptor(path)
