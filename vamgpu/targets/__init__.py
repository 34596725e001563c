"""Targets: meshes, bundled shapes and their voxels."""
