from my_policy.adapter import MyPolicy as Model
