"""Experiments beyond the thesis: each runs its robots and controls, and makes the table and the figure of its page.

Here belongs what one experiment measures of worlds that conf/experiment/ describes; nothing imports it but its command.
"""
