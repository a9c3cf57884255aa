"""Evaluation of an estimate: metrics, the evaluation of a log, and its report."""
