"""What a user describes: bodies, shapes, materials, articulations and their files, what drives them."""
