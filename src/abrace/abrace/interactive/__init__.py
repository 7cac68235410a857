"""What `import abrace` gives: the libraries, with arguments by name or file, and results that show themselves."""
