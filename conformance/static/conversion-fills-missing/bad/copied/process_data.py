def with_action(data):
    if "action" not in data:
        data["action"] = data.get("state", {})
    return data
