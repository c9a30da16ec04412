"""Contact detection at a configuration: pairs of shapes in contact, contact points, normals and gaps."""
