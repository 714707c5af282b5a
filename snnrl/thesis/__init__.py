"""The thesis beside this model: its published values, runs, comparison, claims, figures, report, and the fit."""
