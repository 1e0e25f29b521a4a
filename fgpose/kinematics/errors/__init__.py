"""What the errors of joints do to angles."""
