"""Parts of a scene: bodies, shapes, materials, articulations and their files, prescribed motion and control."""
