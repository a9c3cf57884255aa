"""Covariances: the noise that residuals show, marginals of poses and landmarks."""
