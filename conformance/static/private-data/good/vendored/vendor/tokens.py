KEY = "observation.images.cam_high_480_640_3"
secret_key = read("wandb_api_key_of_the_user_2024_01_01")
sha = "3f9c1b7a2e8d4c6f5a0b9e7d1c3f2a4b6d8e0f1c"
