"""How good an estimate is: pure metrics first, then what gathers them from a log, then the report."""
