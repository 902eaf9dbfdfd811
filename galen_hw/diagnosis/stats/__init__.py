"""Statistics without physics: sampling, linear algebra, the paired test and its levels."""
