"""An evaluation as text and tables, all made from its JSON."""
