"""Methods tried on an image, on two images of a plane, and on a recording (`vo features`)."""
