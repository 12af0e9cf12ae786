"""Sweeps, ablations, comparisons and replications: execution, tables, statistics, reports."""
