"""Commands of ``dslam import``."""
