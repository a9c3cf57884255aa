"""Drives mapped live, and what that costs against a replay."""
