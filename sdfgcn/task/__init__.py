"""The nouns that all else is built on: scene, push space, world, camera and regions."""
