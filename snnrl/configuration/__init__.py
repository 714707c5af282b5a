"""What may be set, in which bounds, how it is composed, whether it makes sense, and what is built from it.

Here belongs what turns text into descriptions and descriptions into state: descriptions hold numbers, the checks look
at nothing else, the builder is plain wiring. The only room that knows Hydra's files.
"""
