"""An evaluation, or several, as one self-contained page that opens offline."""
