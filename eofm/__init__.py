"""Elastographic optical flow: how soft samples move when they are pressed.

Arrays in, arrays out. Images are arrays of shape (height, width), displacements of shape
(2, height, width) in px: lateral (to the right), then axial (down).

From two images
    estimate_displacement   displacement by the preset, or by the paper's method; its error bars
    track                   motion of large speckle formations (bubbles)
    identify_stiffness      relative modulus and the displacement that goes with it
    deviations              error bars of an identified sample
    analyse                 displacement, strain, quality and figures of a pair or sequence
    read_scene              the images of files and what is known of them, for `analyse`

Samples whose truth is known
    true_field, background_field    displacement of a sample with and without its inclusions
    make_phantom, make_tomograms    images of bubbles; tomograms of a virtual OCT experiment
    relative_errors                 how far an estimate is from the truth

Values
    Known                   what is known beside the images: bubbles, background, edges, ...
    Estimation, Tracking, Identification, Measures      settings of the steps above
    Sample, Inclusion, Forward, Phantom, VirtualOct     settings of what is simulated
    Pair, Scene, Estimate, Analysis, Figures            described pairs, and results
    InputError              what is wrong with an input, in one line
    io                      files: TIFF and other images, fields, tables

The command ``eofm --help`` has the same steps for files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
