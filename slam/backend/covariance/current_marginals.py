"""The marginal covariances at the current estimate, computed once for it."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import gtsam
import numpy as np

from slam.backend.batch_solver import BatchSolver, GtsamCalls
from slam.backend.covariance.marginals import Marginals, compute_marginals, marginals_one_by_one
from slam.backend.factors import Factor
from slam.backend.solver_options import FactorGraphConfig

logger = logging.getLogger(__name__)


class CurrentMarginals:
    """Covariances of all variables, computed anew once the estimate has changed."""

    def __init__(self, config: FactorGraphConfig, calls: GtsamCalls) -> None:
        self._config = config
        self._calls = calls
        self._latest: tuple[gtsam.Values, Marginals] | None = None

    def of(self, solver: BatchSolver, factors: Mapping[int, Factor]) -> Marginals:
        """Those at the estimate of a solver; ``factors`` has what each of its factors was made of, by number."""
        values = solver.estimate()
        if self._latest is None or self._latest[0] is not values:
            with self._calls.doing("the marginal covariances"):
                self._latest = values, self._compute(solver, values, factors)
        return self._latest[1]

    def _compute(self, solver: BatchSolver, values: gtsam.Values, factors: Mapping[int, Factor]) -> Marginals:
        try:
            records = [factors[number] for number in solver.numbers]
            return compute_marginals(solver.graph, values, records, self._config)
        except np.linalg.LinAlgError as error:
            logger.info("the marginals come one by one from the incremental solver: %s", error)
            return marginals_one_by_one(solver.graph, values)
