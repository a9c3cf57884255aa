"""A fuzzer of all readers and commands; see ``python -m tests.fuzz --help`` and docs/results/faults.md."""
