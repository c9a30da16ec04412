"""What people see of a recording: page, pictures, plots."""
