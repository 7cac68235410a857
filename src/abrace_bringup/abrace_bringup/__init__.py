"""What an operator starts and looks at: launch files."""
