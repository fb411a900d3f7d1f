def all_episodes(folder):
    return dict(enumerate(sorted(folder.glob("*.hdf5"))))
