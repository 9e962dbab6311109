"""Token sequences sorted, and packed so that a shared prefix runs through a model once."""
