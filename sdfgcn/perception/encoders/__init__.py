"""ImageNet-pretrained networks that turn images of objects into features (`encoder=NAME`)."""
