"""Covariances: the noise of the input estimated, marginals of poses and landmarks."""
