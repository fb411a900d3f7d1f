def convert(folder):
    return {number: path for number, path in [(0, next(folder.glob("*.hdf5")))]}


def all_episodes(folder):
    found = {}
    for number, path in enumerate(folder.glob("*.hdf5")):
        found[number] = path
    return found
