"""What a person reads: progress on the terminal, tables, report.html."""
