"""Programs for tomographic printing compared by a judge that belongs to none of them."""
