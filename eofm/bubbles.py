"""Speckle tracking: detect large speckle formations (bubbles) and follow them."""

from dataclasses import dataclass
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import KDTree
from skimage.feature import peak_local_max
from skimage.measure import regionprops_table
from skimage.segmentation import watershed

Array = NDArray[np.float64]


def detect(I, smoothing=1.0, threshold=0.1, min_area=4, max_area=400):
    smooth = ndimage.gaussian_filter(I, smoothing, mode="mirror")
    base = np.median(smooth); 
    base = smooth.min()
    level = base + threshold * (np.percentile(smooth,99.5) - base)
    peaks = peak_local_max(smooth, min_distance=1, threshold_abs=level, exclude_border=False)
    markers = np.zeros(I.shape, int); markers[tuple(peaks.T)] = np.arange(1, len(peaks)+1)
    labels = watershed(-smooth, markers, mask=smooth > level)
    t = pd.DataFrame(regionprops_table(labels, smooth-level, properties=("label","area","intensity_max","centroid_weighted")))
    t.columns = ["label","area","brightness","x2","x1"]
    p = peaks[t.label-1]
    t["p1"]=p[:,1].astype(float); t["p2"]=p[:,0].astype(float)
    # quadratic log fit
    z = np.log(np.maximum(np.pad(smooth,1,mode="reflect")-base+1e-9,1e-9))
    for ax,name in ((1,"p1"),(0,"p2")):
        o=[0,0]; o[ax]=1
        c=z[p[:,0]+1,p[:,1]+1]; a=z[p[:,0]+1-o[0],p[:,1]+1-o[1]]; b=z[p[:,0]+1+o[0],p[:,1]+1+o[1]]
        d=a-2*c+b
        t[name]+=np.clip(np.where(d<0,.5*(a-b)/np.where(d<0,d,-1),0),-.5,.5)
    return t[(t.area>=min_area)&(t.area<=max_area)].reset_index(drop=True)


def match(t1, t2, prediction, gate=2.0, cols=("p1","p2")):
    x1=t1[list(cols)].to_numpy(); x2=t2[list(cols)].to_numpy()
    pred=x1+prediction
    near=KDTree(pred).sparse_distance_matrix(KDTree(x2), gate, output_type="coo_matrix")
    i,j=near.row,near.col
    cost=(near.data/gate)**2+ .5*abs(np.log(t1.brightness.to_numpy()[i]/t2.brightness.to_numpy()[j]))+.25*abs(np.log(t1.area.to_numpy()[i]/t2.area.to_numpy()[j]))
    n,m=len(x1),len(x2)
    ii=np.r_[i,np.arange(n)]; jj=np.r_[j,m+np.arange(n)]; cc=np.r_[cost+1e-6,np.full(n,1.0)]
    r,c=min_weight_full_bipartite_matching(sparse.csr_array((cc,(ii,jj)),shape=(n,m+n)))
    ok=c<m
    return r[ok],c[ok]

def neighbours_agree(x,d,k=8,tol=3.0,eps=.15):
    t=KDTree(x); _,idx=t.query(x,k=min(k+1,len(x)))
    nb=d[idx[:,1:]]
    med=np.median(nb,axis=1)
    r=abs(nb-med[:,None]); rm=np.median(r,axis=1)
    return (abs(d-med)/(rm+eps)).max(1)<tol

def track(I1,I2,background=None,cols=("p1","p2"),gate=2.0,smoothing=1.0,threshold=.1,tol=3.):
    t1,t2=detect(I1,smoothing,threshold),detect(I2,smoothing,threshold)
    x=t1[list(cols)].to_numpy()
    pred=np.zeros_like(x) if background is None else np.stack([ndimage.map_coordinates(c,x.T[::-1],order=1,mode="nearest") for c in background],1)
    r,c=match(t1,t2,pred,gate,cols)
    d=t2[list(cols)].to_numpy()[c]-x[r]
    ok=neighbours_agree(x[r],d-pred[r],tol=tol)
    return x[r][ok].T,d[ok].T


def refine(I1, I2, x, d, radius=2.0, iterations=10):
    """Sub-pixel registration of Gaussian windows."""
    from eofm.images import evaluate, gradient
    n = int(np.ceil(3 * radius))
    o = np.mgrid[-n:n+1, -n:n+1][::-1].reshape(2, 1, -1).astype(float)
    at = x[:, :, None] + o
    h, w = I1.shape
    inside = lambda q: (q[0] >= 0) & (q[0] <= w-1) & (q[1] >= 0) & (q[1] <= h-1)
    g = np.exp(-(o**2).sum(0)/(2*radius**2)) * inside(at)
    P = evaluate(I1, at)
    G1, G2 = gradient(I2)
    d = d.copy()
    for _ in range(iterations):
        to = at + d[:, :, None]
        wt = g * inside(to)
        r = evaluate(I2, to) - P
        a, b = evaluate(G1, to), evaluate(G2, to)
        A11, A12, A22 = (wt*a*a).sum(1), (wt*a*b).sum(1), (wt*b*b).sum(1)
        b1, b2 = -(wt*a*r).sum(1), -(wt*b*r).sum(1)
        lam = 1e-3*(A11+A22)+1e-12
        A11 = A11+lam; A22=A22+lam
        det = A11*A22-A12**2
        s = np.stack([A22*b1-A12*b2, A11*b2-A12*b1])/det
        d += np.clip(s, -.5, .5)
    Q = evaluate(I2, at+d[:, :, None])
    def c(z): 
        z = z-(wt*z).sum(1,keepdims=True)/wt.sum(1,keepdims=True); return z
    zp, zq = c(P), c(Q)
    corr = (wt*zp*zq).sum(1)/np.sqrt((wt*zp**2).sum(1)*(wt*zq**2).sum(1)+1e-30)
    return d, corr
