"""What every part of abrace stands on: models with named signals, their simulation, bags, and the node conventions."""
