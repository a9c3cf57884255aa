"""Whole drives: mapped in processes of their own, and evaluated."""
