"""The thesis beside this model: its published values, comparison, claims, measurements, figures, report, and the fit.

Here belongs what is true of this one thesis. Nothing imports it but the commands.
"""
