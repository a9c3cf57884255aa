"""The commands of ``dslam benchmark``."""
