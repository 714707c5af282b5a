"""What runs mean: correctness criteria and summaries."""
