"""What runs mean: criteria, comparison with the thesis, figures and the report."""
