<<<<<<< HEAD
python one.py
=======
python other.py
>>>>>>> main
