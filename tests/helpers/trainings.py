"""Trainings of two steps an epoch."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch

from descriptors.training import trainer


@contextmanager
def short_trainings() -> Iterator[pytest.MonkeyPatch]:
    """Torch's settings, which are the process's, are put back."""
    threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "STEPS_PER_EPOCH", 2)
        yield patch
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(deterministic)
