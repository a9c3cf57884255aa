"""The learned likelihood: a map tower and a query tower whose inner product is a log-likelihood ratio."""
