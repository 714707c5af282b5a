"""What may be set, in which bounds, and how it is composed; the only room that knows Hydra's files.

Nothing here knows of state: descriptions hold numbers, the builder turns them into modules.
"""
