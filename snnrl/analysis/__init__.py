"""What runs mean: correctness criteria and published values."""

from pathlib import Path

PUBLISHED = Path(__file__).with_name("published.yaml")
