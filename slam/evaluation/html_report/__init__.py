"""An evaluation as one self-contained page that opens offline."""

from slam.evaluation.html_report.page import compose_page, write_report

__all__ = ["compose_page", "write_report"]
