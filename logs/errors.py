"""What can go wrong with a log. One root, so that a caller catches one thing."""


class LogError(Exception):
    """A log cannot be used; the message says what, where and what to do. ``exit code 2`` on the command line."""


class UnreadableLogError(LogError):
    """The file is missing, is no MCAP, or is damaged beyond what can be passed over."""


class TopicSelectionError(LogError):
    """No topic, or more than one, fits what is asked for; the message lists the topics of the log."""


class InvalidRecordError(LogError):
    """A message decodes to values that no record may have (NaN, an invalid rotation); carries topic and time.

    ``reason`` is the same text for every message that is wrong in the same way, so that they can be counted.
    """

    def __init__(self, message: str, *, reason: str = "") -> None:
        super().__init__(message)
        self.reason = reason


class UnwritableLogError(LogError):
    """The output cannot be created, written or finished."""


class DatasetError(LogError):
    """Files of a foreign dataset are missing or do not have the layout that the importer knows."""
