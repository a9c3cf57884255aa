"""An evaluation as text and picture."""
