"""ImageNet-pretrained networks that turn pictures of objects into features (`encoder=NAME`)."""
