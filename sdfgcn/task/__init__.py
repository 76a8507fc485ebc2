"""The core types of the task: scene, push space, world, camera and regions."""
