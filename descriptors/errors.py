"""What can go wrong with descriptors; they know nothing of SLAM, so they have their own root."""


class DescriptorError(Exception):
    """A constellation that cannot be described, or a descriptor that does not exist."""


class WeightsError(DescriptorError):
    """A file of trained weights that does not exist, is damaged or does not fit its network."""
