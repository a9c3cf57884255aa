"""The factor graph and its optimisation; the only importer of GTSAM."""
